"""Points, masks and grey canvases: everything a generator is told about the vehicle."""

from generator.conditions.conditions import ConditionFrame as ConditionFrame
from generator.conditions.conditions import Conditions as Conditions
from generator.conditions.conditions import make_conditions as make_conditions
from generator.conditions.conditions import require_visible as require_visible
from generator.conditions.folder import read as read
from generator.conditions.folder import read_insertion as read_insertion
from generator.conditions.folder import write as write
from generator.conditions.folder import write_insertion as write_insertion
