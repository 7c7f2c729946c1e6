# What the package offers; read by type checkers, and by lazy_loader when a name is first used.
from .channel import Channel as Channel
from .channel import outline as outline
from .export import write_bids as write_bids
from .export import write_nwb as write_nwb
from .process import describe_file as describe_file
from .read import UsableTrials as UsableTrials
from .read import join_trials as join_trials
from .read import read_recording as read_recording
from .read import read_trials as read_trials
from .read import read_usable_trials as read_usable_trials
from .write import load_ensemble as load_ensemble
from .write import load_recording as load_recording
from .write import whole_file as whole_file
from .write import write_ensemble as write_ensemble
from .write import write_models as write_models
from .write import write_recording as write_recording
from .write import write_simulation as write_simulation
