"""The ways a command can end that a person at the stage can do something about."""


class InputError(ValueError):
    """What was given cannot be used: one sentence that names the file and the field, and what was expected."""


class DeviceError(RuntimeError):
    """A device failed: one sentence that names the device, what was sent, what came back and what to do next."""


class EndedEarlyError(RuntimeError):
    """Somebody ended it before it was complete: one sentence that says who wanted what, and how to go on."""
