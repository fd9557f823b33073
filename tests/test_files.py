"""CSV columns with units, read or refused with file and line; files that are written whole or not at all."""

import csv
import stat

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from valvesim.errors import InputError
from valvesim.io import check_folder, line_of_key, read_columns, write_atomically, write_columns

WANTED = {"time": "s", "current": "A"}


@pytest.fixture
def table(tmp_path):
    """Writes a text, or bytes, to a file and gives its path."""

    def write(content):
        path = tmp_path / "shock.csv"
        path.write_bytes(content if isinstance(content, bytes) else content.encode("utf-8"))
        return path

    return write


def refusal(function, *arguments):
    """The message of the InputError, of exactly that type, that a call ends in."""
    with pytest.raises(InputError) as caught:
        function(*arguments)
    assert type(caught.value) is InputError
    return str(caught.value)


# ---------------------------------------------------------------- reading


@pytest.mark.parametrize(
    "content",
    [
        "time [ms],current [mA]\n0,1\n500,-2.5\n",
        "time [ms],current [mA]\r\n0,1\r\n500,-2.5",
        b"\xef\xbb\xbftime [ms],current [mA]\n0,1\n500,-2.5\n",  # as spreadsheets write it
        "\n  \ntime [ms],current [mA]\n\n0,1\n   \n500,-2.5\n\n\n",
        "  time  [ ms ] , current[mA]  \n 0 , 1\n5e2,\t-2.5 \n",
        '"time [ms]","current [mA]"\n"0","1"\n"500","-2.5"\n',
        "note [1],current [mA],time [ms]\n9,1,0\nx,-2.5,500\n",  # a column that nobody wants may hold anything
        "time [s],current [A]\n0,0.001\n0.5,-0.0025\n",
    ],
)
def test_columns_are_read_by_name_and_converted(table, content):
    columns = read_columns(table(content), WANTED)
    assert list(columns) == ["time", "current"]
    assert all(column.dtype == float for column in columns.values())
    assert columns["time"] == pytest.approx(np.array([0.0, 0.5]), rel=1e-12)
    assert columns["current"] == pytest.approx(np.array([1e-3, -2.5e-3]), rel=1e-12)


def test_temperatures_are_converted_with_their_offset(table):
    columns = read_columns(table("oil [degF]\n-40\n212\n"), {"oil": "degC"})
    assert columns["oil"] == pytest.approx(np.array([-40.0, 100.0]), abs=1e-9)


@given(st.lists(st.tuples(st.floats(-1e9, 1e9), st.floats(-1e9, 1e9)), min_size=1))
def test_every_number_survives_the_file(tmp_path_factory, rows):
    path = tmp_path_factory.mktemp("csv") / "a.csv"
    with open(path, "w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([["time [s]", "current [A]"], *rows])
    columns = read_columns(path, WANTED)
    assert list(zip(columns["time"], columns["current"], strict=True)) == rows


HEAD = "time [s],current [mA]\n"


@pytest.mark.parametrize(
    "content, message",
    [
        ("", ": holds no data (a header line and rows of numbers are expected)"),
        ("\n \n", ": holds no data (a header line and rows of numbers are expected)"),
        (HEAD, ": holds no data (a header line and rows of numbers are expected)"),
        ("time,current [mA]\n0,1\n", ", line 1: column 'time' needs a name and a unit, such as 'time [s]'"),
        ("time [],current [mA]\n0,1\n", ", line 1: column 'time []' needs a name and a unit, such as 'time [s]'"),
        ("[s],current [mA]\n0,1\n", ", line 1: column '[s]' needs a name and a unit, such as 'time [s]'"),
        (HEAD.strip() + ",\n0,1,\n", ", line 1: column '' needs a name and a unit, such as 'time [s]'"),
        (HEAD.replace(",", ";") + "0;1\n",
         ", line 1: column 'time [s];current [mA]' needs a name and a unit, such as 'time [s]'"),
        ("\n\ntime\n0\n", ", line 3: column 'time' needs a name and a unit, such as 'time [s]'"),
        ("time [s],time [ms]\n0,1\n", ", line 1: column 'time' stands there twice"),
        ("\ntime [s],currant [mA]\n0,1\n", ", line 2: no column 'current'; did you mean 'currant'?"),
        ("time [s],p [bar]\n0,1\n", ", line 1: no column 'current'; valid names: p, time"),
        ("time [s],current [mA]\n0,0,5\n", ", line 2: 3 cells under 2 columns; is a comma a point?"),
        (HEAD + "0,1\n\n\n1,\n", ", line 5: gap in column 'current'"),
        (HEAD + "0,1\n1,  \n", ", line 3: gap in column 'current'"),
        (HEAD + "0,1\n1\n", ", line 3: gap in column 'current'"),
        (HEAD + ",\n1,1\n", ", line 2: gap in column 'time'"),
        (HEAD + "\n0,1\n1,abc\n", ", line 4: 'abc' in column 'current' is not a number"),
        (HEAD + '0,"0,5"\n', ", line 2: '0,5' in column 'current' is not a number"),
        (HEAD + '0,"1\n2"\n1,1\n', ", line 3: '1\\n2' in column 'current' is not a number"),
        (HEAD + "0,1\n1, nan\n", ", line 3: nan in column 'current' is not a finite number"),
        (HEAD + "0,1\n-inf,2\n", ", line 3: -inf in column 'time' is not a finite number"),
        (HEAD + "0,1e999\n", ", line 2: 1e999 in column 'current' is not a finite number"),
        ("time [s],current [bar]\n0,1\n",
         ", line 1: column 'current': 'bar' has the wrong dimension; expected a unit that converts to 'A'"),
        ("time [s],current [ma/]\n0,1\n",
         ", line 1: column 'current': unknown unit 'ma/'; expected one that converts to 'A'"),
        ("time [s],current [kA]\n0,1e307\n", ", line 1: column 'current': 1e+307 kA is too large a number in 'A'"),
    ],
)  # fmt: skip
def test_a_file_that_makes_no_sense_is_refused_with_its_line(table, content, message):
    path = table(content)
    assert refusal(read_columns, path, WANTED) == f"{path}{message}"


@pytest.mark.parametrize(
    "content, reason",
    [
        (b"time [s],current [mA]\n0,\xb5\n", "can't decode byte 0xb5"),
        (HEAD + "0," + "1" * 200_000, "field larger than field limit"),
    ],
)
def test_a_file_that_is_no_csv_text_is_refused(table, content, reason):
    path = table(content)
    message = refusal(read_columns, path, WANTED)
    assert message.startswith(f"{path}: cannot be read (") and reason in message


def test_a_missing_file_is_named(tmp_path):
    assert refusal(read_columns, tmp_path / "no.csv", WANTED) == f"{tmp_path / 'no.csv'}: no such file"


def test_a_folder_is_not_read_as_a_file(tmp_path):
    message = refusal(read_columns, tmp_path, WANTED)
    assert message.startswith(f"{tmp_path}: cannot be read (") and "it is a folder" in message


def test_a_name_that_no_file_can_have_is_refused():
    assert "cannot be read (embedded null byte)" in refusal(read_columns, "a\0.csv", WANTED)


@given(st.binary(max_size=60))
def test_any_bytes_after_a_header_are_either_numbers_or_refused(tmp_path_factory, content):
    path = tmp_path_factory.mktemp("csv") / "a.csv"
    path.write_bytes(HEAD.encode() + content)
    try:
        columns = read_columns(path, WANTED)
    except InputError as error:
        assert str(path) in str(error)
    else:
        assert np.isfinite([columns["time"], columns["current"]]).all()


# ---------------------------------------------------------------- writing


def write_new(path):
    path.write_text("new", encoding="utf-8")


def test_a_file_is_written_into_folders_that_are_made(tmp_path):
    path = tmp_path / "results" / "a" / "run.nc"
    assert write_atomically(path, write_new) == path
    assert path.read_text(encoding="utf-8") == "new"
    assert [p.name for p in path.parent.iterdir()] == ["run.nc"]


def test_a_written_file_can_be_read_by_everyone(tmp_path):
    path = write_atomically(tmp_path / "run.nc", write_new)
    assert stat.S_IMODE(path.stat().st_mode) == 0o644


def test_an_old_file_is_replaced(tmp_path):
    path = tmp_path / "run.nc"
    path.write_text("old", encoding="utf-8")
    write_atomically(str(path), write_new)
    assert path.read_text(encoding="utf-8") == "new"
    assert list(tmp_path.iterdir()) == [path]


def test_while_it_is_written_the_old_content_stands_beside_it(tmp_path):
    path = tmp_path / "run.nc"
    path.write_text("old", encoding="utf-8")
    seen = []

    def write(temporary):
        write_new(temporary)
        seen.append((temporary.parent, temporary.suffix, path.read_text(encoding="utf-8")))

    write_atomically(path, write)
    assert seen == [(tmp_path, ".nc", "old")]


@pytest.mark.parametrize("half", [True, False])
@pytest.mark.parametrize("old", ["old", None])
@pytest.mark.parametrize("error", [ValueError("no"), KeyboardInterrupt(), InputError("no")])
def test_a_writer_that_fails_leaves_everything_as_it_was(tmp_path, error, old, half):
    path = tmp_path / "run.nc"
    if old:
        path.write_text(old, encoding="utf-8")

    def write(temporary):
        if half:
            temporary.write_text("ha", encoding="utf-8")
        else:
            temporary.unlink()
        raise error

    with pytest.raises(type(error)) as caught:
        write_atomically(path, write)
    assert caught.value is error
    assert {p.name: p.read_text(encoding="utf-8") for p in tmp_path.iterdir()} == ({"run.nc": old} if old else {})


@pytest.mark.parametrize("error", [OSError("disk full"), OSError(28, "disk full")], ids=str)
def test_a_disk_that_fails_is_an_input_error_and_keeps_the_old_content(tmp_path, error):
    path = tmp_path / "run.nc"
    path.write_text("old", encoding="utf-8")

    def write(temporary):
        raise error

    message = refusal(write_atomically, path, write)
    assert message == f"{path}: cannot be written (disk full)"
    assert {p.name: p.read_text(encoding="utf-8") for p in tmp_path.iterdir()} == {"run.nc": "old"}


def test_a_folder_in_the_place_of_the_file_is_refused_and_left_alone(tmp_path):
    path = tmp_path / "run.nc"
    path.mkdir()
    message = refusal(write_atomically, path, write_new)
    assert message.startswith(f"{path}: cannot be written (") and "Is a directory" in message
    assert list(tmp_path.iterdir()) == [path] and list(path.iterdir()) == []


@pytest.mark.parametrize("below, reason", [("run.nc", "File exists"), ("more/run.nc", "Not a directory")])
def test_a_folder_that_cannot_be_made_is_refused(tmp_path, below, reason):
    file = tmp_path / "file"
    file.write_text("old", encoding="utf-8")
    message = refusal(write_atomically, file / below, write_new)
    assert message.startswith(f"{file / below}: cannot be written (") and reason in message and f"'{file}" in message
    assert list(tmp_path.iterdir()) == [file] and file.read_text(encoding="utf-8") == "old"


def test_a_name_that_is_too_long_or_impossible_is_refused(tmp_path):
    assert "File name too long" in refusal(write_atomically, tmp_path / ("a" * 300), write_new)
    assert "cannot be written (embedded null byte)" in refusal(write_atomically, tmp_path / "a\0b", write_new)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_for_results_is_made_and_left_empty(tmp_path):
    folder = tmp_path / "results" / "a"
    check_folder(folder)
    check_folder(folder)  # and may be there already
    assert list(folder.iterdir()) == []


@pytest.mark.parametrize(
    "below, reason", [("", "File exists"), ("results", "Not a directory"), ("a\0b", "embedded null byte")]
)
def test_a_folder_for_results_that_cannot_be_made_is_refused(tmp_path, below, reason):
    file = tmp_path / "file"
    file.write_text("old", encoding="utf-8")
    message = refusal(check_folder, file / below)
    assert message.startswith(f"{file / below}: cannot be written (".replace("\0", "\\x00")) and reason in message
    assert list(tmp_path.iterdir()) == [file] and file.read_text(encoding="utf-8") == "old"


# --- lines of keys ---------------------------------------------------------------------------------------------------

TEXT = '''title = "null_gap = 3"   # duration
duration = "1 s"

[ valve ]
"null_gap" = "1 mm"
thermal.x = 1
  [[records]]
file = "a.csv"
[[records]]
  file = "b.csv"   # records.1
more = { file = "c.csv", list = [{ deep = 1 }] }
[command.current]
table = { times = """
0, 1 s""", values = "0, 1 mA" }
names = [
  "a",
]
last.one = 3
'''


@pytest.mark.parametrize(
    "keys, line",
    [
        (("duration",), 2), (("title",), 1), (("valve",), 4), (("valve.null_gap",), 5), (("valve.thermal.x",), 6),
        (("valve.thermal",), 6), (("records",), 7), (("records.1",), 7), (("records.1.file",), 8),
        (("records.2",), 9), (("records.2.file",), 10), (("records.2.more.list.1.deep",), 11), (("command",), 12),
        (("command.current.names",), 15), (("command.current.last.one",), 18), (("command.current.none",), 12),
        (("valve.none",), 4), (("none.null_gap",), None), (("none", "valve.null_gap"), 5), ((), None),
        (("file",), None),
    ],
)  # fmt: skip
def test_the_line_of_a_key_is_where_it_stands_or_else_its_table(keys, line):
    assert line_of_key(TEXT, keys) == line


@given(st.lists(st.text("ab.[]{}=\"'# 1\\\n\r\u2028", max_size=20), max_size=8), st.text("ab.", max_size=6))
def test_no_text_breaks_the_search_for_a_line(lines, key):
    found = line_of_key("\n".join(lines), (key,))
    assert found is None or 1 <= found <= "\n".join(lines).count("\n") + 1


# --- columns there and back ------------------------------------------------------------------------------------------


@given(st.lists(st.floats(-1e300, 1e300), min_size=1, max_size=5))
def test_columns_that_are_written_are_read_back_to_nine_digits(tmp_path_factory, values):
    path = write_columns(
        tmp_path_factory.getbasetemp() / "columns.csv",
        {"time [s]": np.arange(len(values)), "current [mA]": np.array(values)},
    )
    assert path.read_text(encoding="utf-8").splitlines()[0] == "time [s],current [mA]"
    read = read_columns(path, {"time": "s", "current": "mA"})["current"]
    assert read == pytest.approx(values, rel=1e-8)
