"""What can go wrong with arguments, files and reconstructions."""


class ArgumentError(ValueError):
    """An argument, option or setting has no possible value, or does not go with another one."""


class Recon3dError(Exception):
    """Base of all errors that a user can mend by changing data or settings."""


class FailedTestError(Recon3dError):
    """A user's own photo-consistency test raised an error, or gave no verdict."""


class DataError(Recon3dError):
    """A file or folder does not hold what its format promises."""


class DownloadError(Recon3dError):
    """A data set could not be downloaded, is not what was expected, or could not be unpacked."""


class SceneError(Recon3dError):
    """Views, bounds and images do not fit together."""


class SceneWarning(UserWarning):
    """Views, bounds and masks of a scene that was opened may not fit together; what is wrong may be found out."""

    def __init__(self, message: str, about: str) -> None:
        super().__init__(message)
        self.about = about
        """As of a ``Finding``: "cameras", "bounds" or "masks"."""


class CalibrationError(Recon3dError):
    """The photographs do not determine their cameras."""


class VisibilityError(Recon3dError):
    """The cameras break the constraint that a carving method needs."""


class VolumeTooLargeError(Recon3dError):
    """The volume would not fit into memory."""


class NoRoomError(Recon3dError):
    """There is no room for the temporary files of a run."""


class OpenMeshError(Recon3dError):
    """A mesh is not closed, and what is asked for needs one that is."""


class EmptyReconstructionError(Recon3dError):
    """Nothing was left after carving."""
