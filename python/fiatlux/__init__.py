"""Environments of the Fiatlux benchmark: a humanoid that puts a ladder under a lamp, climbs it and swaps the bulb.

Importing the package registers the environments. ``gymnasium.make("Fiatlux-S05-CarryBulbToDisposal-v1")`` plays one episode at a
time, by the benchmark's own rules; ``gymnasium.make_vec`` with the same id, or :class:`VectorEnv`, steps many worlds in one call
for training. :func:`evaluate` plays a policy through the benchmark in this process, :class:`Client` on servers, :class:`Bag`
reads a recorded episode, :func:`submit` sends a run to a leaderboard, and :class:`WholeBody` controls legs and waist for other
policies.
"""

from pkgutil import extend_path as _extend_path

from ._native import BENCHMARK_VERSION, FiatluxError, __version__
from ._register import register as _register
from .bag import Bag
from .baseline import Baseline
from .client import Client
from .climber import Climber
from .dataset import export_lerobot
from .env import Env
from .evaluation import Evaluation, evaluate
from .expert import Expert, Experts, Label, Labels, SessionExpert, label
from .grip import Grip
from .hand import HandActions, load_policy
from .kinematics import Kinematics
from .policy import Policy, PolicyLike
from .settings import ROBOTS, Camera, EpisodeSettings, Settings, cameras, segments
from .submission import SubmissionError, submit
from .tasks import TASKS, Task
from .vector import ClimbingVectorEnv, SharedSettings, Start, VectorEnv, WalkingVectorEnv
from .whole_body import WholeBodies, WholeBody

# Generated messages (fiatlux.v3) may be in another folder of the path.
__path__ = _extend_path(__path__, __name__)

_register()

__all__ = [
    "BENCHMARK_VERSION",
    "ROBOTS",
    "TASKS",
    "Bag",
    "Baseline",
    "Camera",
    "Client",
    "Climber",
    "ClimbingVectorEnv",
    "Env",
    "EpisodeSettings",
    "Evaluation",
    "Expert",
    "Experts",
    "FiatluxError",
    "Grip",
    "HandActions",
    "Kinematics",
    "Label",
    "Labels",
    "Policy",
    "PolicyLike",
    "SessionExpert",
    "Settings",
    "SharedSettings",
    "Start",
    "SubmissionError",
    "Task",
    "VectorEnv",
    "WalkingVectorEnv",
    "WholeBodies",
    "WholeBody",
    "__version__",
    "cameras",
    "evaluate",
    "export_lerobot",
    "label",
    "load_policy",
    "segments",
    "submit",
]
