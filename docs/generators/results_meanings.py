"""What the keys of results.json hold."""

OPEN = {"plan", "findings[].numbers"}
"""Keys whose content is documented elsewhere."""

MEANINGS = {
    "schema": "Number of this format; this page describes 3. Results of schemas 1 and 2 are read as well.",
    "labkit_version": "Version of labkit that made the results.",
    "created": "When, ISO 8601 in UTC.",
    "plan_sha256": "SHA-256 of the plan's file.",
    "plan": "The plan that the results were made with, as [tables](plan.md).",
    "convention": "Focus model: {confval}`fit.convention`.",
    "reference_wavelength_nm": "Wavelength that waves are counted in.",
    "wavefronts": "One for each range and channel:",
    "wavefronts[].key": "Its identity, which findings refer to:",
    "wavefronts[].key.range_mm": "Range in mm; null where it is unknown.",
    "wavefronts[].key.channel": "Channel's name.",
    "wavefronts[].key.tile": "Row and column of a tile of the field; null for the whole frame.",
    "wavefronts[].range_mm": "Range as the plan or the CSV states it; null where it is unknown.",
    "wavefronts[].measured_range_mm": "Range at which the rail was read to stand.",
    "wavefronts[].channel": "Channel's name.",
    "wavefronts[].wavelength_nm": "Estimated wavelength of the channel, or the stated one if the photographs call it exact.",
    "wavefronts[].spectrum": (
        "Its light, `[[nm, share], ...]`, as the plan states it or the photographs call for it, by a few wavelengths of the "
        "same moments. MTF, Strehl ratio, encircled energy and PSFs are of all of it. Null for one wavelength."
    ),
    "wavefronts[].pupil": (
        "The pupil's rim, lengths over the full pupil's radius, angles from x (right) towards y (down); null for a clear disc. "
        "F-numbers are those of the circle with the full pupil's clear area, and modes are Zernike's over it: a cat's eye, "
        "which cuts the full pupil, changes neither."
    ),
    "wavefronts[].pupil.cuts": "Edges that limit it, the innermost at every angle.",
    "wavefronts[].pupil.cuts[].blades": "Number of a diaphragm's blades.",
    "wavefronts[].pupil.cuts[].turn_deg": "Direction of the middle of a blade.",
    "wavefronts[].pupil.cuts[].roundness": "Curvature of the blades, 0 where they are straight, 1 where they make a circle.",
    "wavefronts[].pupil.cuts[].shift": "Distance of a circle's centre from the pupil's.",
    "wavefronts[].pupil.cuts[].radius": "Radius of a circle.",
    "wavefronts[].pupil.cuts[].direction_deg": "Direction of its shift.",
    "wavefronts[].pupil.uneven": "Relative departures of the outline along cos 2t, sin 2t, cos 3t and sin 3t.",
    "wavefronts[].pupil.obstructed": "Share of the outline's area that is obstructed.",
    "wavefronts[].f_number": "F-number of the cone that reaches the sensor, by the full pupil's clear area.",
    "wavefronts[].f_number_working": "The same with its standard error.",
    "wavefronts[].f_number_working.value": "Value.",
    "wavefronts[].f_number_working.std": "Standard error.",
    "wavefronts[].lambda_n_um": (
        "Wavelength times f-number, the scale of diffraction on the sensor; null where the fit belongs to no lens."
    ),
    "wavefronts[].lambda_n_um.value": "Value.",
    "wavefronts[].lambda_n_um.std": (
        "Standard error, which includes that of the wavelength, but no doubt about the pixel pitch."
    ),
    "wavefronts[].blur_um": (
        "Diameter of defocus's geometric blur on the sensor, negative before best focus; null where the fit "
        "belongs to no lens."
    ),
    "wavefronts[].blur_um.value": "Value.",
    "wavefronts[].blur_um.std": "Standard error.",
    "wavefronts[].noll": "Noll's numbers of the estimated modes.",
    "wavefronts[].waves_rms": (
        "Coefficient of each mode, waves RMS, as the whole session has it where the fit belongs to it."
    ),
    "wavefronts[].sign_open": (
        "Whether the twin is as likely, which makes the same photographs: all even modes, defocus too, have the other sign "
        "there. So it is from one range."
    ),
    "wavefronts[].twin_waves_rms": "Coefficients of the twin; null where the sign is determined.",
    "wavefronts[].std": "Standard error of each coefficient.",
    "wavefronts[].errors_known": (
        "Whether `std` and `covariance` hold: not where the optimum is doubtful, or where the model is incomplete and no other "
        "range confirms the numbers. The report prints no errors there."
    ),
    "wavefronts[].covariance": "Covariance of the coefficients.",
    "wavefronts[].pose": "Perspective of the first photograph, eight numbers.",
    "wavefronts[].poses": "Perspective of each photograph.",
    "wavefronts[].gain": "Counts per photo-electron.",
    "wavefronts[].read_noise": "Standard deviation of a dark pixel, counts.",
    "wavefronts[].chi2_per_pixel": (
        "Squared residual over the noise's variance, mean over the pixels; 1 where the model explains the photographs."
    ),
    "wavefronts[].global_test": "How the optimum was found and tested; null where it was not:",
    "wavefronts[].global_test.name": (
        'What decided: `"residuals"`, `"session"` (the other fits), `"starts"` (many ended in the same optimum), or '
        '`"parts"` (a fit with parts of the camera that the model lacks).'
    ),
    "wavefronts[].global_test.p_value": "Chance of residuals as large as these.",
    "wavefronts[].global_test.accepted": "Whether the optimum is accepted as the best one.",
    "wavefronts[].global_test.undetermined": (
        "Combinations of modes whose standard error exceeds λ/4. One is enough to reject a fit."
    ),
    "wavefronts[].global_test.starts": "How many starts the search made.",
    "wavefronts[].global_test.others": "Up to five other optima that the search met, the likeliest first:",
    "wavefronts[].global_test.others[].waves_rms": "Coefficients there.",
    "wavefronts[].global_test.others[].log_likelihood_below": "How much lower its log-likelihood is, about.",
    "wavefronts[].optimum": "Is this the best optimum?",
    "wavefronts[].optimum.accepted": "As in `global_test`.",
    "wavefronts[].optimum.p_value": "As in `global_test`.",
    "wavefronts[].optimum.others": "How many other optima the search met.",
    "wavefronts[].model": "Does the model explain the photographs? Another question than that of the optimum:",
    "wavefronts[].model.accepted": "Whether the residuals are noise alone.",
    "wavefronts[].model.p_value": "Chance of residuals as large as these.",
    "wavefronts[].model.missing": "Parts of the camera that the model seems to lack.",
    "wavefronts[].model.residual_spectrum": "Power of the residuals by spatial frequency, mean over all directions:",
    "wavefronts[].model.residual_spectrum.cycles_per_px": "Spatial frequency, cycles per pixel of the raw file.",
    "wavefronts[].model.residual_spectrum.power": "Power over the noise's: 1 where noise alone is left.",
    "wavefronts[].model.residual_spectrum.power_without_parts": (
        "The same without the parts of the camera that were found; null where none were, "
        "or where the fits that show them best are not explained without them."
    ),
    "wavefronts[].seconds": "Time that the fit took.",
    "wavefronts[].frames": "Photographs that it is of.",
    "wavefronts[].origin_px": "Row and column, in the photograph, of the first pixel that was fitted.",
    "wavefronts[].shape_px": "Rows and columns of the cut that was fitted.",
    "wavefronts[].tile": "Row and column of the tile; null for the whole frame.",
    "wavefronts[].pulls": (
        "Each mode of a tile's own fit less the prediction of all other tiles, over the standard error of the difference; null "
        "without a field."
    ),
    "wavefronts[].centre_px": "Row and column of the tile's middle; of tiles only.",
    "wavefronts[].corners_px": (
        "Corners of the target in each photograph, `[row, column]`, as fitted; of the tile where a "
        "large target is cut."
    ),
    "focus": "Best focus and pupil magnification; null where ranges or defocus are missing:",
    "focus.best_focus_mm": "By channel:",
    "focus.best_focus_mm.NAME": "Range of best focus on the stated scale.",
    "focus.best_focus_mm.NAME.value": "Value, mm.",
    "focus.best_focus_mm.NAME.std": "Standard error, mm.",
    "focus.pupil_magnification": "Diameter of the exit pupil over that of the entrance pupil:",
    "focus.pupil_magnification.value": "Value.",
    "focus.pupil_magnification.std": "Standard error.",
    "focus.pupil_magnification.identifiable": "Whether these ranges determine it: a standard error of at most 0.1.",
    "focus.residual_waves": "By channel:",
    "focus.residual_waves.NAME": "Measured less fitted defocus of each range, waves RMS.",
    "focus.residual_std_waves": "By channel:",
    "focus.residual_std_waves.NAME": "Standard error of each of these, waves RMS.",
    "focus.covariance": "Covariance of the channels' best focus in order, then of the pupil magnification.",
    "focus.chi2_per_freedom": "χ² per degree of freedom; null where there are as many unknowns as measurements.",
    "lens": "The lens that all ranges and channels have in common, or null:",
    "lens.focal_length_mm": "Focal length.",
    "lens.focal_length_mm.value": "Value, mm.",
    "lens.focal_length_mm.std": "Standard error, mm.",
    "lens.modes": "Zernike modes of the fits.",
    "lens.modes.noll": "First and last mode that the photographs called for, by Noll. Where modes were added, `wavefronts` "
    "have weaker ones beyond.",
    "lens.modes.orders": "Radial orders beyond 4 that the session added: `order`, and `waves_rms`, RMS of its modes with its "
    "standard error, in the wavefront that determines them best.",
    "lens.pupil": "The pupil that all photographs share.",
    "lens.pupil.blades": "Number of the diaphragm's blades; null for none.",
    "lens.pupil.turn_deg": "Direction of the middle of a blade, from right towards down; null for none.",
    "lens.pupil.turn_deg.value": "Value, degrees.",
    "lens.pupil.turn_deg.std": "Standard error, degrees.",
    "lens.pupil.roundness": "Curvature of the blades: 0 straight, 1 a circle; null for none.",
    "lens.pupil.roundness.value": "Value.",
    "lens.pupil.roundness.std": "Standard error.",
    "lens.pupil.obstruction": "Diameter of the obstructed centre, relative to the full pupil.",
    "lens.pupil.obstruction.value": "Value.",
    "lens.pupil.obstruction.std": "Standard error, 0 where the plan states it.",
    "lens.pupil.rim": "Departures of an uneven rim from the circle.",
    "lens.pupil.rim[].k": "Number of periods around the rim.",
    "lens.pupil.rim[].cos": "Relative departure along cos kt.",
    "lens.pupil.rim[].cos.value": "Value.",
    "lens.pupil.rim[].cos.std": "Standard error.",
    "lens.pupil.rim[].sin": "Relative departure along sin kt.",
    "lens.pupil.rim[].sin.value": "Value.",
    "lens.pupil.rim[].sin.std": "Standard error.",
    "lens.pupil.cats_eye": "The cutting circle, in units of the full pupil's radius, to its blades' corners; null for none.",
    "lens.pupil.cats_eye.shift": "Distance of its centre from the pupil's.",
    "lens.pupil.cats_eye.shift.value": "Value.",
    "lens.pupil.cats_eye.shift.std": "Standard error.",
    "lens.pupil.cats_eye.radius": "Radius.",
    "lens.pupil.cats_eye.radius.value": "Value.",
    "lens.pupil.cats_eye.radius.std": "Standard error.",
    "lens.pupil.cats_eye.direction_deg": "Direction of its centre, from right towards down.",
    "lens.pupil.cats_eye.direction_deg.value": "Value.",
    "lens.pupil.cats_eye.direction_deg.std": "Standard error.",
    "lens.pupil.outer_f_number": "F-number at infinity by the full pupil; `lens.f_number` is by its clear area.",
    "lens.pupil.outer_f_number.value": "Value.",
    "lens.pupil.outer_f_number.std": "Standard error.",
    "lens.f_number": "F-number at infinity.",
    "lens.f_number.value": "Value.",
    "lens.f_number.std": "Standard error.",
    "lens.pupil_magnification": "As in `focus`.",
    "lens.pupil_magnification.value": "Value.",
    "lens.pupil_magnification.std": "Standard error.",
    "lens.range_zero_mm": "True ranges, from the front principal plane, less the stated ones.",
    "lens.range_zero_mm.value": "Value, mm.",
    "lens.range_zero_mm.std": "Standard error, mm.",
    "lens.wavelengths_nm": "By channel:",
    "lens.wavelengths_nm.NAME": "Estimated wavelength, or the stated one if the photographs call it exact.",
    "lens.wavelengths_nm.NAME.value": "Value, nm.",
    "lens.wavelengths_nm.NAME.std": "Standard error, nm.",
    "budget": "Standard error of each leading number, such as `best_focus_mm.G`, by source; the squares add up:",
    "budget.NAME": "One number's:",
    "budget.NAME.photons": "Light and read noise of the photographs.",
    "budget.NAME.calibration": "Flats.",
    "budget.NAME.geometry": "Lens, tape, rail, sizes and lateral colour, as stated.",
    "budget.NAME.model": "Wavelengths, the floor of defocus, and what disagrees.",
    "joint": "With `labkit fit --joint`, by number: by how many of its standard errors it moved; else empty.",
    "joint.NAME": "One number's.",
    "model_parts": "What was fitted of the camera, such as `low_pass_filter.spread_px`:",
    "model_parts.NAME": "One number's:",
    "model_parts.NAME.value": "Value, in the unit that ends its name.",
    "model_parts.NAME.std": "Standard error.",
    "parts_tried": "Parts of the camera that the fit tried:",
    "parts_tried[].part": "Its name.",
    "parts_tried[].gain": "Log-likelihood that it would gain, by the likelihood's slope.",
    "parts_tried[].adopted": "Whether it was taken into the model.",
    "field": (
        "The wavefront over the frame, where the target is a grid; null without. The coefficients' covariance, in the order of "
        "the terms, is in `field.npz`:"
    ),
    "field.photograph_px": "Rows and columns of the photograph; half its diagonal is the unit of the field's polynomials.",
    "field.f_number": "Working f-number in the middle of the frame.",
    "field.f_number_std": "Its standard error.",
    "field.wavelengths_nm": "Wavelength of each channel:",
    "field.wavelengths_nm.G": "One channel's, nm.",
    "field.lambda_n_um": "Wavelength times f-number in the middle of the frame, of each channel:",
    "field.lambda_n_um.G": "One channel's:",
    "field.lambda_n_um.G.value": "Value.",
    "field.lambda_n_um.G.std": (
        "Standard error, which includes that of the wavelength, but no doubt about the pixel pitch."
    ),
    "field.pupil": "The pupil's rim over the frame; null where it is round everywhere.",
    "field.pupil.middle": "Rim that all places have in common, as of `wavefronts[].pupil`:",
    "field.pupil.middle.cuts": "Edges that limit it.",
    "field.pupil.middle.uneven": "Relative departures of the outline.",
    "field.pupil.middle.obstructed": "Share of the outline's area that is obstructed.",
    "field.pupil.vignetting": "Circle that cuts the pupil away from the middle of the frame, in units of its radius:",
    "field.pupil.vignetting.shift": "Shift of its centre in the frame's corners, along the image height.",
    "field.pupil.vignetting.right": "Shift in the middle of the frame, to the right.",
    "field.pupil.vignetting.down": "The same, down.",
    "field.pupil.vignetting.radius": "Radius of the circle.",
    "field.pupil.uneven": "Second and third harmonic of the rim's radius in the corners, along the image height, relative.",
    "field.terms": "Terms of the double Zernike expansion, of every channel, field and pupil in turn:",
    "field.terms[].field": "Noll's number of the polynomial in the place on the sensor.",
    "field.terms[].pupil": "Noll's number of the mode in the pupil.",
    "field.terms[].channel": "Name of the channel.",
    "field.terms[].waves": "Its coefficient:",
    "field.terms[].waves.value": "Value, waves RMS at the reference wavelength.",
    "field.terms[].waves.std": "Standard error.",
    "field.sensor_tilt_um_per_mm": (
        "Slope of the sensor over the image of the leading channel, down and to the right; positive where the sensor lies "
        "farther behind its image:"
    ),
    "field.sensor_tilt_um_per_mm.value": "Down the rows and along the columns, µm/mm.",
    "field.sensor_tilt_um_per_mm.covariance": "Their covariance.",
    "field.curvature_per_mm": (
        "Distance of the sensor behind its image over the square of the image height:"
    ),
    "field.curvature_per_mm.value": "Value, mm per mm².",
    "field.curvature_per_mm.std": "Standard error.",
    "field.distortion": (
        "Radial distortion by the places of the tiles of a grid, r (1 + k1 r² + k2 r⁴); null for other tiles:"
    ),
    "field.distortion.k1_per_mm2": "Growth of the image for each mm² of image height squared:",
    "field.distortion.k1_per_mm2.value": "Value, 1/mm².",
    "field.distortion.k1_per_mm2.std": "Standard error.",
    "field.distortion.k2_per_mm4": "The same of fifth order, where the places ask for it:",
    "field.distortion.k2_per_mm4.value": "Value, 1/mm⁴.",
    "field.distortion.k2_per_mm4.std": "Standard error.",
    "field.distortion.centre_px": "Centre of the distortion, where k1 is three errors from zero:",
    "field.distortion.centre_px.value": "Row and column in the photograph, pixels.",
    "field.distortion.centre_px.covariance": "Their covariance.",
    "field.distortion.residual_px": "RMS of the coordinates of the tiles' middles about the model, pixels.",
    "field.lateral_colour": (
        "Lateral colour of each channel but the reference, which is G or the first channel; null without distortion:"
    ),
    "field.lateral_colour.NAME": "One channel's:",
    "field.lateral_colour.NAME.scale": "Size of the image over that of the reference, less 1:",
    "field.lateral_colour.NAME.scale.value": "Value.",
    "field.lateral_colour.NAME.scale.std": "Standard error.",
    "field.lateral_colour.NAME.shift_um": "Shift of the image in the middle of the frame, down and to the right:",
    "field.lateral_colour.NAME.shift_um.value": "Down the rows and along the columns, µm on the sensor.",
    "field.lateral_colour.NAME.shift_um.covariance": "Their covariance.",
    "common": (
        "Numbers of the lens that all ranges share, for `labkit compare`, with their joint covariance; null without a lens:"
    ),
    "common.names": (
        "`waves.G.7`: Noll mode 7 of G, waves RMS; `colour_um.R`: focal length of R less that of G, µm; "
        "`best_focus_mm.G`: of G or the first channel; `ln_pupil_magnification`: its logarithm."
    ),
    "common.values": "Their values.",
    "common.covariance": (
        "Their joint covariance, with the plan's numbers taken as right within their errors."
    ),
    "common.stated": "Numbers that were known before the photographs, such as the engraved f-number:",
    "common.stated.NAME": "One number's:",
    "common.stated.NAME.value": "Value as known; 0 for relative errors and logarithms.",
    "common.stated.NAME.std": "Standard error as known.",
    "common.stated.NAME.moves": "Change of each value for a change of this number by its standard error.",
    "light": "Of channels whose plan names the light, by the tables that come with labkit:",
    "light.NAME": "One channel's:",
    "light.NAME.name": "Kind of light.",
    "light.NAME.filters": "Body whose filters were taken; `typical`: the mean of all in the table.",
    "light.NAME.mean_nm": "Mean wavelength of the light times the filter:",
    "light.NAME.mean_nm.value": "Value, nm.",
    "light.NAME.mean_nm.std": "Standard deviation among the lights of the kind, and among bodies where none is known, nm.",
    "light.NAME.width_nm": "Standard deviation of its wavelengths:",
    "light.NAME.width_nm.value": "Value, nm.",
    "light.NAME.width_nm.std": "Standard deviation among lights and bodies, nm.",
    "widest_light_nm": "Of channels of unknown spectrum or named light: [how broad](../method/session.md) their light may be.",
    "widest_light_nm.NAME": "Largest standard deviation that photographs and a named light allow, with 95 % confidence, nm.",
    "focus_waves_per_nm": "How defocus changes within a channel by the longitudinal colour of all; empty with one channel:",
    "focus_waves_per_nm.NAME": "Noll 4, waves RMS at the reference wavelength per nm.",
    "findings": "What to know of the numbers:",
    "findings[].code": "What was found: [codes](../troubleshooting/fit.md), none of which changes its meaning.",
    "findings[].where": "Wavefront concerned; without a range all of the channel; without a channel the session:",
    "findings[].where.range_mm": "As in the wavefront's `key`.",
    "findings[].where.channel": "As in the wavefront's `key`.",
    "findings[].where.tile": "As in the wavefront's `key`.",
    "findings[].numbers": "By name, with the unit at its end; they depend on the code.",
    "findings[].text": "The same as a sentence.",
    "warnings": "Texts of the findings that warn.",
    "unanswered": "What these photographs cannot determine though it was to be estimated, in words; or null.",
    "made_from": "Inputs of the fit beside the plan: by these `labkit reprocess` knows whether the results are up to date.",
    "made_from.frames_sha256": "SHA-256 of names, kinds, ranges and checksums of the session's photographs.",
    "made_from.numerics_sha256": "SHA-256 of the source of labkit's numerics.",
    "made_from.own_plan": "Whether the plan is the session's own.",
    "made_from.ranges_mm": "Ranges that were to be fitted; null for all.",
    "made_from.channels": "Channels that were to be fitted; null for all.",
    "made_from.noll": "First and last mode that were requested; null for the plan's.",
    "made_from.patience_s": "Processor time of one search (`--patience`); null without a limit.",
    "made_from.joint": "Whether `--joint` was requested.",
    "made_from.split": "Whether `--split` was requested.",
    "made_from.plain": "Whether `--plain` was requested.",
    "made_from.failed": "A sentence for each fit that failed.",
    "made_from.failed_accepted": "Whether the user accepts the results without the fits that failed.",
}
