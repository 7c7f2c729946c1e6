# What the package offers; read by type checkers, and by lazy_loader when a name is first used.
from .diagnosis import write_diagnosis as write_diagnosis
from .experiment import write_experiment_report as write_experiment_report
from .folder import write_folder as write_folder
from .identification import write_identification as write_identification
from .sheet import write_recordings as write_recordings
from .sheet import write_sheet as write_sheet
from .studies import problems as problems
from .study import write_report as write_report
