"""A policy of LeRobot whose actions come from a deployment of a gleaner server. Importing it registers `gleaner`."""

from .configuration_gleaner import GleanerConfig
from .modeling_gleaner import GleanerPolicy
from .processor_gleaner import make_gleaner_pre_post_processors

__all__ = ["GleanerConfig", "GleanerPolicy", "make_gleaner_pre_post_processors"]
