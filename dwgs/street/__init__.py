"""A procedural street with exact ground truth: the embedded default, and the test bench."""

from dwgs.street.street import Street as Street
from dwgs.street.street import build_street as build_street
