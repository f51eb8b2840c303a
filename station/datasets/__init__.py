"""What is on disk → frames, inertial samples, drive commands. Truth in a dataset judges, it never estimates."""

from station.datasets.dataset import Dataset, Truth
from station.datasets.opening import open_dataset

__all__ = ["Dataset", "Truth", "open_dataset"]
