"""The default backend: no weights, CPU, deterministic."""

from generator.composite.composite import CompositeGenerator as CompositeGenerator
