import tomllib

from tvsysid.report.toml import toml_text


def test_the_standard_library_reads_it_back():
    settings = {
        "trials": 3, "fast": True, "snr_db": [10.0, float("inf")], "methods": ['own("a\\b")', "k·\n\x7f\x01"],
        "odd key": 1e-20, "nested": {"one": {"two": [1, 2]}, "rows": [{"a": 1, "b c": [True]}]},
    }  # fmt: skip
    assert tomllib.loads(toml_text(settings)) == settings


def test_none_is_left_out():
    assert toml_text({"a": None, "b": [1, None]}) == "b = [1]"
