"""The methods: one file each, behind one verb, ``identify(ensemble) -> model``; and plugins."""

from tvsysid.methods.apply import Identifies as Identifies
from tvsysid.methods.apply import apply as apply
from tvsysid.methods.apply import deviating_channels as deviating_channels
from tvsysid.methods.apply import reason_to_skip as reason_to_skip
from tvsysid.methods.base import Choice as Choice
from tvsysid.methods.base import Input as Input
from tvsysid.methods.base import Method as Method
from tvsysid.methods.birf import BasisIRF as BasisIRF
from tvsysid.methods.eirf import EnsembleIRF as EnsembleIRF
from tvsysid.methods.esm import EnsembleSpectral as EnsembleSpectral
from tvsysid.methods.kbr.kbr import KernelRegression as KernelRegression
from tvsysid.methods.plugins import METHODS as METHODS
from tvsysid.methods.plugins import clashes as clashes
from tvsysid.methods.plugins import create as create
from tvsysid.methods.plugins import describe as describe
from tvsysid.methods.plugins import from_text as from_text
from tvsysid.methods.plugins import key_of as key_of
from tvsysid.methods.plugins import label_of as label_of
from tvsysid.methods.plugins import load as load
from tvsysid.methods.plugins import names as names
from tvsysid.methods.plugins import parse as parse
from tvsysid.methods.plugins import typed as typed
from tvsysid.methods.sds import ShortDataSegments as ShortDataSegments
from tvsysid.methods.tuning.evidence import Evidence as Evidence
from tvsysid.methods.tuning.evidence import Tuned as Tuned
