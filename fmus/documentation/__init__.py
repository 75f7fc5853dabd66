"""What an FMU says about itself to people: a page, licences and a picture."""

from .page import documentation
from .project import project

__all__ = ["documentation", "project"]
