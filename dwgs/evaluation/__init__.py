"""Systems that put a vehicle into a drive, compared: what is measured, and how it is shown."""

from dwgs.evaluation.columns import COLUMNS as COLUMNS
from dwgs.evaluation.columns import Column as Column
from dwgs.evaluation.columns import Measured as Measured
from dwgs.evaluation.measure import Subject as Subject
from dwgs.evaluation.measure import measure as measure
from dwgs.evaluation.table import Cell as Cell
from dwgs.evaluation.table import Table as Table
from dwgs.evaluation.table import tabulate as tabulate
