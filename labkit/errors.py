"""The error tree.

LabkitError                 something failed: one line, exit status 1
├── InputError              what was given cannot be used: one line, exit status 2
│   ├── PlanError           the plan is wrong
│   ├── SessionError        the session folder, its journal or its lock
│   ├── RawError            a file that is no usable photograph
│   ├── TargetError         a target that cannot be made or is not in the frame
│   └── DataError           frames that cannot answer what was asked
├── FitError                an estimate that did not come about
└── DeviceError             a device did not do what it was asked
    ├── DeviceTimeoutError
    ├── CameraError
    ├── RailError
    │   └── RailLimitError
    └── DisplayError
"""


class LabkitError(Exception):
    """Base of everything labkit raises on purpose."""

    exit_status = 1


class InputError(LabkitError):
    """What was given cannot be used as it is."""

    exit_status = 2


class PlanError(InputError):
    """The plan is wrong; the message names field, value and what is allowed."""


class SessionError(InputError):
    """The session folder, its journal or its lock is not as it should be."""


class RawError(InputError):
    """A file is not a photograph that can be used."""


class TargetError(InputError):
    """A target cannot be made, or is not found in the frame."""


class DataError(InputError):
    """The frames cannot answer what was asked."""


class FitError(LabkitError):
    """An estimate did not come about."""


class DeviceError(LabkitError):
    """A device did not do what it was asked."""


class DeviceTimeoutError(DeviceError):
    """A device did not answer in time."""


class CameraError(DeviceError):
    """The camera failed."""


class RailError(DeviceError):
    """The rail failed."""


class RailLimitError(RailError):
    """A position outside the rail's travel."""


class DisplayError(DeviceError):
    """The display failed, or did not confirm what it shows."""
