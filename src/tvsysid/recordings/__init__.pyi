# What the package offers; read by type checkers, and by lazy_loader when a name is first used.
from .channel import Channel as Channel
from .formats import describe_file as describe_file
from .formats import recordings_in as recordings_in
from .read import join_trials as join_trials
from .read import read_recording as read_recording
from .read import read_trials as read_trials
from .read import read_usable_trials as read_usable_trials
from .reading import Reading as Reading
from .reading import Segmentation as Segmentation
from .write import load_ensemble as load_ensemble
from .write import load_recording as load_recording
from .write import whole_file as whole_file
from .write import write_ensemble as write_ensemble
from .write import write_models as write_models
from .write import write_recording as write_recording
from .write import write_simulation as write_simulation
from .write import write_table as write_table
