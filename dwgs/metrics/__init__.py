"""How close one image, one video, one set of them is to another."""

from dwgs.metrics.bootstrap import bootstrap_interval as bootstrap_interval
from dwgs.metrics.frechet import frechet_distance as frechet_distance
from dwgs.metrics.image import psnr as psnr
from dwgs.metrics.image import ssim as ssim
