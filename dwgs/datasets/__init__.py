"""A recorded drive on disk to a `Scene`: one file per source. Foreign conventions end here."""

from dwgs.datasets.resize import resize_scene as resize_scene
