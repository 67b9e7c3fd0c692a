"""The card: facts of the data set, front matter that a hub reads, and no text that becomes markup."""

import re
from html.parser import HTMLParser
from pathlib import Path
from types import ModuleType

import pytest
import yaml
from markdown_it import MarkdownIt

from simulator.config import dump, load_config
from simulator.dataset.card import card
from simulator.dataset.checksums import CARD, CROISSANT, OUR_CARD, is_our_card, read_seal, write_seal
from simulator.dataset.verification import verify


class Structure(HTMLParser):
    """The elements of a page without their text."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.found: list[str] = []
        self.text = ""
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list) -> None:
        self.found.append(f"<{tag} {attrs}>")

    def handle_endtag(self, tag: str) -> None:
        self.found.append(f"</{tag}>")

    def handle_data(self, data: str) -> None:
        self.text += data

    def handle_comment(self, data: str) -> None:
        self.found.append(f"<!--{data}-->")


def parsed(data: bytes) -> tuple[dict, Structure]:
    """Front matter and page, as a strict YAML reader and CommonMark with tables and links see them."""
    _, front, page = data.decode().split("---\n", 2)
    markdown = MarkdownIt("commonmark", {"html": True}).enable(["table", "strikethrough"])
    return yaml.safe_load(front), Structure(markdown.render(page))


def test_facts_of_a_made_data_set(trial) -> None:
    root = trial.generate(camera={"shutter": {"exposure_ms": 5}})
    first = card(root)
    assert first == card(root)
    front, page = parsed(first)
    assert front == {
        "pretty_name": "trial",
        "size_categories": ["n<1K"],
        "task_categories": ["image-to-image", "depth-estimation"],
        "tags": ["lensless-imaging", "simulated"],
    }
    text = " ".join(page.text.split())
    for fact in (
        "5 simulated captures",
        "train 3 validation 1 test 1",
        "48 x 60 pixels, channels R, G, B",
        "16 x 20 pixels",
        "mask design ./plugins.py:corners",
        "mask to sensor 1.9 mm",
        "depths 3, 3.6 cm to 20 cm",
        "noise type gaussian, clip false, peak sample, psnr_db 40.0",
        "shutter type global, exposure_ms 5.0",
        "full scale 3e-06",
        "family ./plugins.py:boxes",
        "flatlight verify FOLDER",
    ):
        assert fact in text
    budget = first.decode().partition("worst first")[2].partition("## Scenes")[0]
    shares = [float(value) for value in re.findall(r"\| ([\d.]+) % \|", budget)]
    assert len(shares) >= 3
    assert shares == sorted(shares, reverse=True)


def test_its_configuration_makes_the_data_set_again(trial) -> None:
    root = trial.generate()
    (text,) = re.findall(r"```yaml\n(.*?)```", card(root).decode(), re.DOTALL)
    again = trial.folder / "again.yaml"
    again.write_text(text)
    assert dump(load_config(again)) == dump(load_config(trial.path))


def test_labels_are_counted(samples: ModuleType, tmp_path: Path) -> None:
    root = samples.make_dataset(tmp_path / "set")
    front, page = parsed(card(root))
    assert "image-classification" in front["task_categories"]
    assert "class 0 2 class 1 1 class 2 1" in " ".join(page.text.split())


HOSTILE = [
    "</details><script>alert(1)</script>",
    "a | b | c\n\n# heading\n\n---\n- list",
    "x\n```\n</details>\n<b>bold</b>\n``````\ny",
    "![x](http://example.org/x.png) [y](javascript:z) <http://example.org> http://example.org www.example.org a@b.org",
    "**bold** _so_ `code` ~~gone~~ &lt;b&gt; &amp;",
    f"\n{OUR_CARD}\n-->",
    "\u202egnirts\x00\x1b[31m",
    "---\npretty_name: other\n---",
    "x" * 100_000,
]


@pytest.mark.parametrize("text", HOSTILE)
def test_no_text_becomes_markup(samples: ModuleType, tmp_path: Path, text: str) -> None:
    def make(folder: str, words: str):
        config = {
            "name": words,
            "seed": 7,
            "scene": {"family": words, "note": words},
            "camera": {"mask": {"design": words}},
        }
        shown = {"name": words, "config": config, "versions": {words: words}}
        return samples.make_dataset(tmp_path / folder, lambda index: samples.make_sample(index, label=words), **shown)

    front, plain = parsed(card(make("plain", "word")))
    found, page = parsed(card(make("hostile", text)))
    assert page.found == plain.found
    written = card(tmp_path / "hostile").decode()
    before = written.partition("\n# ")[2].partition("<details>")[0]
    assert not re.search(r"https?://|www\.", before)  # hubs make links of it
    assert found.keys() == front.keys()
    assert re.sub(r"[\s\W]+", "", found["pretty_name"])[:50] == re.sub(r"[\s\W]+", "", text)[:50]
    assert all(line.isprintable() for line in written.splitlines())


def test_our_card_is_sealed_and_the_user_s_is_not(dataset: Path) -> None:
    path = dataset / CARD
    assert not is_our_card(path)
    path.write_bytes(card(dataset))
    (dataset / CROISSANT).write_text("{}")
    assert is_our_card(path)
    write_seal(dataset)
    assert {CARD, CROISSANT} < set(read_seal(dataset) or {})
    assert verify(dataset).notes == ()
    assert verify(dataset).ok
    whole = path.read_text()
    # Also where the last line is damaged, by which a run knows it for ours: until a run has sealed it as the user's.
    changed = (f"{whole[:50]} changed {whole[50:]}", "", whole[:10], whole.replace(OUR_CARD, ""), f"{whole}more")
    for text in (*changed, whole.replace("flatlight card", "flatlight cord")):
        path.write_text(text)
        (problem,) = verify(dataset).problems
        assert problem.startswith(f"{path}: ")
    for own in ("my notes", whole.replace(OUR_CARD, ""), f"{whole}more", f"x{OUR_CARD}\n"):
        path.write_text(own)
        assert not is_our_card(path)
        if own.startswith("---"):
            write_seal(dataset)
        report = verify(dataset)
        assert report.ok, report.problems
        assert [line.split(":")[0] for line in report.notes] == [CARD]
        write_seal(dataset)
        assert CARD not in (read_seal(dataset) or {})
        path.write_text(whole)
        write_seal(dataset)
    path.write_text(OUR_CARD)
    assert is_our_card(path)
    path.unlink()
    path.mkdir()
    assert not is_our_card(path)
