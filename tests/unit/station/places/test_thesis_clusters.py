"""The thesis mode on clouds that are too large for DBSCAN itself."""

import numpy as np

from station.places.making.clusters import cluster_thesis
from station.places.making.config import ThesisConfig


def test_a_large_cloud_is_voxelised_and_gives_the_same_clusters() -> None:
    rng = np.random.default_rng(5)
    blobs = [rng.normal(centre, 0.2, (3000, 3)) for centre in ((0.0, 0.0, 0.0), (3.0, 0.0, 0.0))]
    p = np.concatenate([*blobs, rng.uniform(-20, 20, (50, 3))])
    config = ThesisConfig(eps=0.3, min_pts=11)
    exact = cluster_thesis(p, config, is_metric=True)
    cells = cluster_thesis(p, config, is_metric=True, voxelise_above=2000)
    assert (exact.count, cells.count) == (2, 2)
    assert exact.parameters["cell"] is None and isinstance(cells.parameters["cell"], float)
    assert (exact.label == cells.label).mean() > 0.99
    np.testing.assert_array_equal(cells.label[:3000:500], cells.label[0])
