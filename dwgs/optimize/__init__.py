"""What both fits share: parameters, losses, schedule, events."""

from dwgs.optimize.checkpoint import Checkpoint as Checkpoint
from dwgs.optimize.events import Evaluated as Evaluated
from dwgs.optimize.events import Event as Event
from dwgs.optimize.events import Grown as Grown
from dwgs.optimize.events import Preparing as Preparing
from dwgs.optimize.events import Step as Step
from dwgs.optimize.losses import RetainedMse as RetainedMse
from dwgs.optimize.losses import dssim as dssim
from dwgs.optimize.losses import weighted_l1 as weighted_l1
from dwgs.optimize.losses import weighted_mse as weighted_mse
from dwgs.optimize.parameters import PoseParameters as PoseParameters
from dwgs.optimize.parameters import Rates as Rates
from dwgs.optimize.parameters import SplatParameters as SplatParameters
from dwgs.optimize.parameters import Together as Together
from dwgs.optimize.schedule import count_steps as count_steps
from dwgs.optimize.schedule import fill_time as fill_time
from dwgs.optimize.schedule import hold_then_decay as hold_then_decay
from dwgs.optimize.schedule import view_order as view_order
