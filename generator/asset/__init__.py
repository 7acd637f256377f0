"""A backend of few words: an asset drawn into the frame, with a shadow of its own. No weights, no light."""

from generator.asset.asset import AssetGenerator as AssetGenerator
