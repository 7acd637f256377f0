"""How close one image is to another."""

from dwgs.metrics.image import psnr as psnr
from dwgs.metrics.image import ssim as ssim
