"""What a page is made of."""

from html.parser import HTMLParser

EMPTY = {"meta", "link", "img", "br", "input", "hr"}


class Elements(HTMLParser):
    """Elements of a page in order: name, attributes, text inside."""

    def __init__(self, text):
        super().__init__()
        self.found, self.open = [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.found.append((tag, dict(attrs), []))
        if tag not in EMPTY:
            self.open.append(self.found[-1])

    def handle_endtag(self, tag):
        assert self.open.pop()[0] == tag, f"</{tag}> closes another element"
        if tag in ("th", "td", "caption"):
            self.handle_data(" ")

    def handle_data(self, data):
        for _, _, texts in self.open:
            texts.append(data)

    def of(self, *tags):
        return [
            (attrs, " ".join("".join(texts).split()))
            for tag, attrs, texts in self.found
            if tag in tags
        ]


def table(elements, caption):
    return next(text for _, text in elements.of("table") if text.startswith(caption))


def section(elements, name):
    return next(text for attrs, text in elements.of("section") if attrs["aria-labelledby"] == name)
