from . import benchmark as benchmark
from . import figures as figures
from . import methods as methods
from . import metrics as metrics
from . import preprocess as preprocess
from . import recordings as recordings
from . import report as report
from . import simulate as simulate
from .errors import DoubtfulWarning as DoubtfulWarning
from .errors import InputError as InputError
from .methods import BasisIRF as BasisIRF
from .methods import EnsembleIRF as EnsembleIRF
from .methods import EnsembleSpectral as EnsembleSpectral
from .methods import KernelRegression as KernelRegression
from .methods import ShortDataSegments as ShortDataSegments
from .models import Model as Model
from .numerics.bases import ChebyshevPolynomials as ChebyshevPolynomials
from .numerics.bases import CubicBSplines as CubicBSplines
from .numerics.bases import FourierSeries as FourierSeries
from .numerics.bases import GaussianBumps as GaussianBumps
from .numerics.bases import HaarWavelets as HaarWavelets
from .numerics.bases import LegendrePolynomials as LegendrePolynomials
from .recordings import read_recording as read_recording
from .recordings import read_trials as read_trials
from .signals import Ensemble as Ensemble
from .signals import Recording as Recording

__version__: str
