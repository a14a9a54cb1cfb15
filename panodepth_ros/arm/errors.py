"""What can go wrong with the arm. Every message is a sentence for the user."""


class ArmError(RuntimeError):
    """Trouble with the arm or its controller."""


class ArmConnectionError(ArmError):
    """The port cannot be opened or has vanished."""


class ArmTimeoutError(ArmError, TimeoutError):
    """The controller did not answer in time."""


class ArmProtocolError(ArmError):
    """The controller answered, but with an error or with nonsense."""


class ArmAlarmError(ArmError):
    """The controller is in alarm and refuses to move."""


class ArmPositionError(ArmError):
    """The arm's position is uncertain; it must be homed before it moves again."""


class ArmStoppedError(ArmError):
    """A motion was ended by a stop."""


class ArmBusyError(ArmError):
    """The arm is executing another command."""


class ArmLimitError(ArmError):
    """A motion would wind the cable too far."""
