"""What the documentation needs beside mkdocs: formulas as MathML, tutorials as notebooks, the gallery made afresh."""

import re
import subprocess
import sys
from pathlib import Path

import jupytext
from latex2mathml.converter import convert

GALLERY = {  # folder: (what it shows, words of the command, pages and pictures in it)
    "step": ("A step of current", ("run", "step"), "run"),
    "sweep": ("A sine sweep as Bode and spectrogram", ("run", "sine_sweep", "--set", "outputs.rate=4 kHz"), "sweep"),
    "launch": ("A launch, 20 to 270 °C", ("run", "launch_shock", "--set", "outputs.rate=100 Hz"), "drift"),
    "cold": ("A cold start", ("run", "cold_start", "--set", "outputs.rate=100 Hz"), "run"),
    "bench": ("The static acceptance tests", ("bench",), "bench_20_degC"),
}
NOTEBOOKS = ("launch", "own_valve", "faulty_valve", "position_loop")
FILE = re.compile(r"^<!-- file: (\S+) -->\n```toml\n(.*?)^```$", flags=re.M | re.S)
COMMANDS = re.compile(r"^```bash\n(.*?)^```$", flags=re.M | re.S)


def on_page_markdown(markdown, page, **_):
    """$$ ... $$ and $ ... $ become MathML, which browsers show by themselves; code stays as it is."""
    if page.file.src_uri == "site/gallery/index.md":
        return markdown.replace("GALLERY", "\n\n".join(_entry(name, *entry) for name, entry in GALLERY.items()))
    pieces = re.split(r"(^```.*?^```$|`[^`\n]+`)", markdown, flags=re.M | re.S)
    for k in range(0, len(pieces), 2):
        block = re.sub(r"\$\$(.+?)\$\$", lambda m: convert(m[1], display="block"), pieces[k], flags=re.S)
        pieces[k] = re.sub(r"\$([^$\n]+?)\$", lambda m: convert(m[1]), block)
    return "".join(pieces)


def _entry(name, title, words, picture):
    page = "bench_20_degC" if words[0] == "bench" else "run"
    command = " ".join(f'"{word}"' if " " in word else word for word in words)
    return (
        f'## {title}\n\n<img src="{name}/{picture}.png" alt="{title}" loading="lazy">\n\n'
        f'`valvesim {command}` · <a href="{name}/{page}.html">the page to zoom into</a>\n'
    )


def on_post_page(output, page, **_):
    """The theme's search in an opened folder asks a host for a script of 1 kB: it stands here in its place."""
    up = "../" * page.file.dest_uri.count("/")
    return output.replace("https://unpkg.com/iframe-worker/shim", f"{up}site/assets/iframe-worker.js")


def on_post_build(config, **_):
    """The gallery by its commands, and a notebook of each tutorial."""
    site = Path(config["site_dir"]) / "site"
    for name, (_, words, _) in GALLERY.items():
        folder = site / "gallery" / name
        command = [sys.executable, "-m", "valvesim.cli.main", *words, "-o", str(folder)]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        (folder / "result.nc").unlink(missing_ok=True)
    for name in NOTEBOOKS:
        source = (Path(config["docs_dir"]) / "site" / "tutorials" / f"{name}.md").read_text(encoding="utf-8")
        jupytext.write(jupytext.reads(notebook_text(source), fmt="md"), site / "tutorials" / f"{name}.ipynb")


def notebook_text(source):
    """A tutorial whose files and commands are cells too, so that it runs in a notebook as it stands."""
    text = FILE.sub(lambda m: f"```python\n%%writefile {m[1]}\n{m[2]}```", source)
    return COMMANDS.sub(lambda m: "```python\n" + "".join(f"!{line}\n" for line in m[1].splitlines()) + "```", text)
