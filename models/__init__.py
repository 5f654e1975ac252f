"""Models of the package: files, and builders of the link, of bodies in its place and of robots."""

from mjgranular.models.hexapod import Hexapod as Hexapod
from mjgranular.models.li_robot import LiRobot as LiRobot
from mjgranular.models.link import Link as Link
from mjgranular.models.link import Projectile as Projectile
from mjgranular.models.link import model_path as model_path
from mjgranular.models.robots import robot_path as robot_path
from mjgranular.models.worm import Worm as Worm
