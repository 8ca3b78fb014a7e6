"""What the keys of results.json hold."""

OPEN = {"plan"}
"""Keys whose content is documented elsewhere."""

MEANINGS = {
    "schema": "Number of this format; this page describes 2. Results of schema 1 are read as well.",
    "labkit_version": "Version of labkit that made the results.",
    "created": "When, ISO 8601 in UTC.",
    "plan_sha256": "SHA-256 of the plan's file.",
    "plan": "The plan that the results were made with, as [tables](plan.md).",
    "convention": "Focus model: {confval}`fit.convention`.",
    "reference_wavelength_nm": "Wavelength that waves are counted in.",
    "wavefronts": "One for each range and channel:",
    "wavefronts[].range_mm": "Range as the plan or the CSV states it; null where it is unknown.",
    "wavefronts[].measured_range_mm": "Range at which the rail was read to stand.",
    "wavefronts[].channel": "Channel's name.",
    "wavefronts[].wavelength_nm": "Channel's wavelength.",
    "wavefronts[].spectrum": (
        "Its light, `[[nm, share], ...]`, as the plan states it or the photographs call for it, by a few wavelengths of the "
        "same moments. MTF, Strehl ratio, encircled energy and PSFs are of all of it. Null for one wavelength."
    ),
    "wavefronts[].f_number": "F-number of the cone that reaches the sensor.",
    "wavefronts[].f_number_working": "The same with its standard error.",
    "wavefronts[].f_number_working.value": "Value.",
    "wavefronts[].f_number_working.std": "Standard error.",
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
    "wavefronts[].std": "Standard error of each coefficient.",
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
        "The same before parts of the camera were taken into the model; null where none were."
    ),
    "wavefronts[].seconds": "Time that the fit took.",
    "wavefronts[].frames": "Photographs that it is of.",
    "wavefronts[].origin_px": "Row and column, in the photograph, of the first pixel that was fitted.",
    "wavefronts[].shape_px": "Rows and columns of the cut that was fitted.",
    "wavefronts[].corners_px": "Corners of the target in each photograph, `[row, column]`, as fitted.",
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
    "focus.covariance": "Covariance of the channels' best focus in order, then of the pupil magnification.",
    "focus.chi2_per_freedom": "χ² per degree of freedom; null where there are as many unknowns as measurements.",
    "lens": "The lens that all ranges and channels have in common, or null:",
    "lens.focal_length_mm": "Focal length.",
    "lens.focal_length_mm.value": "Value, mm.",
    "lens.focal_length_mm.std": "Standard error, mm.",
    "lens.f_number": "F-number at infinity.",
    "lens.f_number.value": "Value.",
    "lens.f_number.std": "Standard error.",
    "lens.pupil_magnification": "As in `focus`.",
    "lens.pupil_magnification.value": "Value.",
    "lens.pupil_magnification.std": "Standard error.",
    "lens.range_zero_mm": "True ranges, from the front principal plane, less the stated ones.",
    "lens.range_zero_mm.value": "Value, mm.",
    "lens.range_zero_mm.std": "Standard error, mm.",
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
    "warnings": "In words; [troubleshooting](../troubleshooting/index.md) explains them.",
    "unanswered": "What these photographs cannot determine though it was to be estimated, in words; or null.",
}
