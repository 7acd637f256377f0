"""The nouns: what every stage takes and hands on. NumPy only."""

from dwgs.scene.asset import Casting as Casting
from dwgs.scene.asset import Shading as Shading
from dwgs.scene.asset import VehicleAsset as VehicleAsset
from dwgs.scene.asset import Wheel as Wheel
from dwgs.scene.background import Background as Background
from dwgs.scene.camera import Camera as Camera
from dwgs.scene.errors import InputError as InputError
from dwgs.scene.gaussians import Gaussians as Gaussians
from dwgs.scene.insertion import Insertion as Insertion
from dwgs.scene.insertion import VehiclePoints as VehiclePoints
from dwgs.scene.lidar import LidarSweep as LidarSweep
from dwgs.scene.scene import Frame as Frame
from dwgs.scene.scene import Scene as Scene
from dwgs.scene.track import Track as Track
from dwgs.scene.trajectory import Trajectory as Trajectory
