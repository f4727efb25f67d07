from .dataset import sweep as sweep
from .questions import known_questions as known_questions
