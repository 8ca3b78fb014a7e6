"""The sentence of every finding, by its code."""

TEXTS = {
    # session and photographs
    "session-mended": "{note}",
    "kept-fits-refused": (
        "{count} of the fits stored in {folder} were altered, or made by another user or on another machine: they were "
        "fitted again"
    ),
    "photographs-unlisted": (
        "{count} photographs in {folder} are not used, such as {first}: the journal does not list them. Its end is lost, or "
        "somebody added the files; labkit verify names them"
    ),
    "same-photograph": "{file} is the same photograph as {same_as}: it counts once",
    "exif-focal-length": (
        "{file} was taken at {focal_length_mm:g} mm by its EXIF, but the plan has lens.focal_length_mm = "
        "{planned_mm:g}: correct the plan, or take photographs of that lens"
    ),
    "exif-f-number": (
        "{file} was taken at f/{f_number:g} by its EXIF, but the plan has {plan_key} = {planned:g}: correct the plan, "
        "or take photographs of that aperture"
    ),
    "settings-differ": (
        "the photographs differ in {setting}: {first_file} has {first}, {file} {other} by their EXIF; a session has "
        "one lens at one setting: make a session for each"
    ),
    "picture-altered": "{note}",
    "picture-processed": (
        "processed pictures ({file_format}, {bits} bit), {tone_curve}: demosaicing, sharpening and noise reduction are "
        "part of the reported PSF, and errors are larger than stated, because neighbouring pixels share "
        "noise; use raw files if possible"
    ),
    "colours-at-half-resolution": (
        "JPEG stores its colours at half resolution: R and B are blurred; use channel G alone, or JPEGs "
        "without subsampling (4:4:4)"
    ),
    "panel-pixels-seen": (
        "the photographs resolve the panel's own pixels, {pitch_mm:.4g} mm apart with {contrast:.0%} of contrast, and the "
        "plan has no [target.pixels]: add {to_add} to [target]"
    ),
    "surround-contradicted": (
        'the plan has target.surround = "{surround}", but the target\'s surround has {level:.0%} of the radiance of its '
        'white: write "{other}", or "unknown" for neither'
    ),
    "surround-uneven": (
        "the {surround} surround next to the target is not even{at}, as where a room begins: without flat frames only pixels "
        "that see nothing but the target are used, and errors are larger"
    ),
    # flats and darks
    "no-dark-frames": (
        "no dark frames: the black level of the files (or the plan) is used, and hot pixels are unknown"
    ),
    "bias-instead-of-darks": "no dark frames: bias frames are used instead, and dark current is neglected",
    "dark-exposure-differs": "dark and target frames differ in exposure time: dark current may be wrong",
    "noise-contradicts-plan": (
        "channel {channel}: {key} = {stated:.4g} in the plan, but the session's own flats and darks show {measured:.4g} ± "
        "{std:.2g}: the session's own is used; correct the plan, whose number holds for one ISO only"
    ),
    "no-flat-frames": (
        "no flat frames: uneven light is fitted as a low-order polynomial, with gain and read noise; all pixels are "
        "assumed to be equal"
    ),
    "flats-of-another-range": "no flat frames{where}: those{taken} are taken instead",
    "flats-partly-unlit": "flat frames{where} leave {unlit:.0%} of the frame unlit: this part is not used",
    "target-at-places": (
        "the photographs show the target at {count} places of the frame: each is a tile of the field"
    ),
    "large-target": (
        "the target is {target_px} pixels wide: {count} tiles of {tile_px} pixels are fitted, {used:.0%} of its area; the "
        "rest, between them or without detail, is left out; [field] tiles = [1, 1] would fit it whole, part_px a part of it"
    ),
    "tiles-not-found": (
        "{count} of {every} tiles are not found{at}, and left out: {named}; are they whole in the frame, lit and not covered?"
    ),
    "tile-left-out": "{where} is left out: {why}",
    "gain-not-measured": "no range has two flat frames: gain is not measured, and equal pixels are assumed",
    # each fit
    "results-corrupt": "results.json could not be read; it is set aside as {aside}",
    "pixels-left-out": (
        "{named}: beyond what the target and any lens can show, by up to {most_stds:.0f} standard deviations of noise; left "
        "out as hot, dead or hit by a cosmic ray, which flats and darks do not show"
    ),
    "fit-left-out": "{note}; completed fits are kept",
    "search-cut-short": (
        "{where}: the search ended after {patience_s:g} s of processor time and {starts} starts without an accepted "
        "optimum; the likeliest is kept, a longer --patience searches further"
    ),
    "fit-mended": "{where}: contradicted the other fits; a new fit from their prediction agrees",
    "fit-does-not-belong": (
        "{where}: contradicts the other fits and is left out of best focus; was the lens touched, or is the optimum "
        "wrong?"
    ),
    "two-camps": (
        "the fits form two groups that contradict each other: {members} follow one lens, {outliers} another; best focus is "
        "of the first; was the lens touched or refocused?"
    ),
    "undetermined": "{where}: the frames do not determine {list}; is the target lit, sharp and large enough?",
    "model-incomplete": (
        "{where}: the residuals are more than noise (p = {p_value:.1g}, χ² per pixel {chi2_per_pixel:.2f}); {confirmed} the "
        "optimum: the model lacks something{such_as}; {errors}"
    ),
    "optimum-doubtful": (
        "{where}: the residuals are more than noise (p = {p_value:.1g}, χ² per pixel {chi2_per_pixel:.2f}); the optimum may "
        "be wrong, or the model lacks something{such_as}; its errors are unknown"
    ),
    "model-incomplete-everywhere": (
        "the residuals of {count} of {fits} fits are more than noise (χ² per pixel {least:.2f} to {most:.2f}); the fits "
        "confirm each other's optima: the model lacks something; standard errors allow for it"
    ),
    "chi2-unusual": "{where}: χ² per pixel is {chi2_per_pixel:.2f}, expected is {low:g} to {high:g}",
    # the session's lens
    "lens-changed": (
        "the lens or its focus was changed between {last_mm:g} and {next_mm:g} mm, as the photographs were taken: the "
        "ranges before and after follow two lenses; `labkit fit --split` fits them separately"
    ),
    "no-best-focus": "no best focus: {why}",
    "channel-without-best-focus": (
        "no best focus of {where}, which needs at least 2 ranges: photograph the target at more ranges"
    ),
    "defocus-sign-open": (
        "{where}: these ranges leave open the sign of defocus and, with it, of all even modes; ranges on both sides of focus "
        "would determine it"
    ),
    "pupil-magnification-at-bound": (
        "no pupil magnification from {least:g} to {most:g} fits: defocus does not follow a lens's curve; check ranges, "
        "focal length and target size"
    ),
    "pupil-magnification-undetermined": (
        "these ranges do not determine the pupil magnification: its standard error is {pupil_magnification_std:.3f}; "
        "ranges near the closest focus would, or smaller errors of focal length and range zero"
    ),
    "plan-contradicted": (
        "the photographs contradict the plan: {key} = {stated:g} is wrong with a probability of {sure} %, the results assume "
        "{agreed}; correct it and fit again; if it is right, check {others}"
    ),
    "cones-contradict-one-lens": (
        "working f-numbers and sizes contradict one lens focused as a whole (the f-number is {cone_relative_error:+.1%} "
        "off): they were not used for focal length, f-number and pupil magnification; are channel.wavelength_nm, "
        "sensor.pixel_pitch_um, target.size_mm and lens.f_number right?"
    ),
    "modes-differ-between-ranges": (
        "the modes differ from range to range beyond their errors: they were estimated for each range"
    ),
    "errors-widened": (
        "the fits depart from one lens by {factor:.1f} times their standard errors (χ² per degree of freedom "
        "{chi2_per_freedom:.1f}); all errors were increased by this factor"
    ),
    # the camera
    "camera-part-found": "the photographs show {part_words}, which the plan does not state: {values_words}",
    "pupil-at-bound": (
        "the {title} ended at the limit of what a pupil can be: its numbers describe nothing; the model lacks something else"
    ),
    "light-contradicted": "the light that the plan names has another width than the photographs show: {list}",
    "higher-modes-found": (
        "the photographs show Zernike modes {first_noll} to {last_noll}, {waves_words} RMS together, which were fitted "
        "besides the usual modes{besides}"
    ),
    "camera-parts-missing": (
        "the photographs show {list}, which the model lacks and which would move {moves}; standard errors include this effect"
    ),
    "stated-model-moves": "the model as the plan states it would move {moves}{rejected}",
    "panel-aperture-found": (
        "a stripe of the panel's pixels is lit over {across} of its third, and over {down} of the pitch"
    ),
    # places of the field's tiles
    "tile-misplaced": (
        "{where}: its place contradicts the other tiles; it is left out of distortion, lateral colour and the target's pose"
    ),
    "target-bent": (
        "the target is bent by {depth}, as the places of its tiles show (p = {p_value:.1g}): use a panel, or a print on glass"
    ),
    "places-undetermined": (
        "the places of the tiles do not determine {list}: photograph more tiles, or the target at more ranges"
    ),
    "tilt-untested": "{words}",
    "perspective-contradicted": (
        "by the places of its tiles the target is tilted differently at each range, which should move the focus over the "
        "frame; {share_words} of that move is there, not 1: the sensor's tilt is estimated with this share; check that the "
        "target is flat, and that no program straightened the photographs"
    ),
    # edges
    "ranges-not-determined": (
        "ranges are not determined: give --psf SESSION with a best focus, or --focus MM"
    ),
    "psf-of-another-camera": "PSF of another camera, by force: {difference}",
    "edge-methods-disagree": (
        "box {at}, channel {channel}: the photograph's response is not the fit's, by {pull:.1f} standard errors, and the fit's "
        "was corrected: see whether the box holds one edge between even sides, and whether the camera moved or a program "
        "changed the photograph"
    ),
    "edge-blurred-otherwise": (
        "box {at}, channel {channel}: no lens makes its blur: {cause}; the response includes it"
    ),
    "edge-bowed": (
        "box {at}, channel {channel}: the edge is curved by {bow_px:.1f} pixels, which the straight line of ISO 12233:2017 "
        "takes for blur: leave --edition 2017 out"
    ),
    "edges-without-common-wavefront": (
        "no wavefront explains the edges together, and each was fitted alone: the camera moved during the exposure, or the "
        "lens differs from edge to edge"
    ),
    # charts
    "chart-edges-left-out": (
        "left out: {cut} edges cut by the frame, {clipped} clipped, {uneven} with uneven sides"
    ),
    "chart-squares-small": (
        "the chart's squares are {side_px:.0f} pixels wide, and edges need {least_px:.0f}: distortion and pose are by its "
        "points alone; photograph larger squares, or from nearer, for MTF and focus"
    ),
    "chart-not-flat": (
        "photograph {number}: the chart's points depart by {rms_px:.2f} px from a plane seen by a lens with radial distortion, "
        "as their neighbours do: is the chart bent?"
    ),
    "chart-edges-not-fitted": "{count} edges of the chart gave no fit, most as: {why}",
    "chart-edges-blurred-otherwise": (
        "{count} of {edges} edges, channel {channel}: no lens makes their blur: {cause}; the responses include it"
    ),
    "chart-edges-along-pixels": (
        "{count} of {edges} edges run within 1 degree of rows or columns and are badly sampled: turn the chart by 5 degrees"
    ),
    "chart-directions-missing": (
        "S and T are not determined at {count} of {places} places, for want of an edge nearly along or across the radius: "
        "photograph the chart turned by 45 degrees as well"
    ),
    "chart-focus-sign-open": (
        "the sign of the focus errors is open: give photographs at two ranges or more, and --range MM for each"
    ),
    "chart-ranges-contradicted": (
        "channel {channel}: defoci depart from those of the stated ranges by {factor:.1f} times their errors, which were "
        "enlarged: check the ranges, and focal length and f-number in the plan"
    ),
}
"""The sentence of each code. `where` is the key's label; other names are numbers, or words made of them."""
