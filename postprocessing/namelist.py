"""Reading and editing keys in the text of a scene, without disturbing its comments and layout.

    groups(text)                                        the groups in order, each with name and values()
    set_key(text, "method.basis", "linear")             set or add a key; a missing group is added at the end
    set_key(text, "body[2].velocity", [0.1, 0.0])       the second &body; body[left] is the one with name = "left"
    set_key(text, "time.step", None)                    take a key away
"""
import re
from dataclasses import dataclass, field

_KEY = re.compile(r"([A-Za-z]\w*)\s*(?:\([^)=]*\))?\s*=")
_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][+-]?\d+)?"
_LITERAL = re.compile(rf"(?:\d+\*)?(?:{_NUMBER}|\.(?:true|false)\.|\.?[tf]\.?|\"[^\"]*\"|'[^']*')", re.IGNORECASE)


class NamelistError(ValueError):
    """A path that names no key, or text that is no scene"""


@dataclass
class Group:
    """One group: where it and its keys stand in the text"""
    name: str
    start: int  # of "&"
    end: int = -1  # of the closing "/"
    keys: dict = field(default_factory=dict)  # name -> (start of the key, start of its value, end of its value)
    text: str = field(default="", repr=False)

    def values(self):
        """Key -> list of Python values"""
        return {key: parse_values(self.text[first:last]) for key, (_, first, last) in self.keys.items()}


def groups(text):
    """The groups of a scene in order"""
    masked = _mask(text)
    found, position = [], 0
    while True:
        start = masked.find("&", position)
        if start < 0:
            return found
        word = re.match(r"\w+", masked[start + 1:])
        end = masked.find("/", start)
        if not word or end < 0:
            raise NamelistError(f"line {text.count(chr(10), 0, start) + 1}: a group is not closed with /")
        group = Group(word.group().lower(), start, end, text=text)
        body = start + 1 + word.end()
        hits = list(_KEY.finditer(masked, body, end))
        for hit, after in zip(hits, [h.start() for h in hits[1:]] + [end]):
            last = hit.end() + len(masked[hit.end():after].rstrip(" \t\r\n,"))
            group.keys[hit.group(1).lower()] = (hit.start(), hit.end(), last)
        found.append(group)
        position = end + 1


def _mask(text):
    """The text with comments blanked and quoted characters replaced, at the same positions"""
    out, quote, comment = [], "", False
    for c in text:
        if c == "\n":
            quote, comment = "", False
            out.append(c)
        elif comment:
            out.append(" ")
        elif quote:
            out.append(c if c == quote else "x")
            quote = "" if c == quote else quote
        elif c in "\"'":
            quote = c
            out.append(c)
        elif c == "!":
            comment = True
            out.append(" ")
        else:
            out.append(c)
    return "".join(out)


def parse_values(text):
    """Python values of a namelist value list: numbers, logicals, texts, repeats such as 3*0.0"""
    masked, kept = _mask(text), []
    for k, c in enumerate(text):  # comments may stand between values
        kept.append(" " if masked[k] == " " else c)
    values = []
    for hit in re.finditer(r"(?:(\d+)\*)?(\"(?:[^\"]|\"\")*\"|'(?:[^']|'')*'|[^\s,;]+)", "".join(kept)):
        values += [_value(hit.group(2))] * int(hit.group(1) or 1)
    return values


def _value(word):
    if word[0] in "\"'":
        return word[1:-1].replace(2*word[0], word[0])  # a doubled quote stands for one
    if word.lower().lstrip(".")[:1] in ("t", "f") and re.fullmatch(r"\.?(t|f|true|false)\.?", word, re.IGNORECASE):
        return word.lower().lstrip(".").startswith("t")
    try:
        return int(word)
    except ValueError:
        try:
            return float(re.sub("[dD]", "e", word))
        except ValueError:
            return word


def format_value(value):
    """A Python value, or text as typed on a command line, as namelist text"""
    if isinstance(value, bool):
        return ".true." if value else ".false."
    if isinstance(value, (list, tuple)):
        return ", ".join(format_value(v) for v in value)
    if isinstance(value, (int, float)):
        return repr(value)
    if hasattr(value, "tolist"):  # numpy
        return format_value(value.tolist())
    words = value.strip()
    rest = _LITERAL.sub("", words)
    if words and not rest.replace(",", "").strip():
        return words
    if words.lower() in ("true", "false"):
        return f".{words.lower()}."
    if re.fullmatch(r"\w+(\s*,\s*\w+)+", words):  # a list of words
        return ", ".join(f'"{w.strip()}"' for w in words.split(","))
    return '"' + words.replace('"', '""') + '"'


def set_key(text, path, value):
    """The scene with group.key = value; value None takes the key away"""
    match = re.fullmatch(r"(\w+)(?:\[([^\]]+)\])?\.(\w+)", path.strip())
    if not match:
        raise NamelistError(f"'{path}' is not of the form group.key, group[2].key or group[name].key")
    name, which, key = match.group(1).lower(), match.group(2), match.group(3).lower()
    for group in reversed(_pick(text, name, which, path)):  # from the back: positions in front stay valid
        text = _edit(text, group, key, value)
    if value is not None and not any(g.name == name for g in groups(text)):
        text = text.rstrip("\n") + f"\n&{name}\n  {key} = {format_value(value)}\n/\n"
    return text


def _pick(text, name, which, path):
    """The groups that a path means"""
    same = [g for g in groups(text) if g.name == name]
    if which is None:
        if len(same) > 1:
            raise NamelistError(f"'{path}': the scene has {len(same)} groups &{name}; "
                                f"write {name}[1].., {name}[its name].. or {name}[*]..")
        return same
    if which == "*":
        return same
    if which.isdigit():
        if not 1 <= int(which) <= len(same):
            raise NamelistError(f"'{path}': the scene has {len(same)} groups &{name}")
        return [same[int(which) - 1]]
    named = [g for g in same if g.values().get("name") == [which]]
    if not named:
        raise NamelistError(f"'{path}': no &{name} has name = \"{which}\"")
    return named


def _edit(text, group, key, value):
    if key in group.keys:
        start, first, last = group.keys[key]
        if value is not None:
            return text[:first] + " " + format_value(value) + text[last:]
        after = re.match(r"[ \t]*,?[ \t]*", text[last:]).end() + last
        line_start = text.rfind("\n", 0, start) + 1
        if not text[line_start:start].strip() and text[after:after + 1] == "\n":  # alone on its line
            return text[:line_start] + text[after + 1:]
        return text[:start] + text[after:]
    if value is None:
        return text
    before = text[:group.end]
    line_start = before.rfind("\n") + 1
    if before[line_start:].strip():  # the slash closes a line of keys
        return before.rstrip(" \t") + f" {key} = {format_value(value)} " + text[group.end:]
    return text[:line_start] + f"  {key} = {format_value(value)}\n" + text[line_start:]


def remove_group(text, name):
    """The scene without the groups of this name"""
    for group in reversed([g for g in groups(text) if g.name == name]):
        text = text[:group.start] + text[group.end + 1:].lstrip(" \t")
    return text


def apply_settings(text, settings):
    """Apply "group.key=value" texts, as typed on a command line; "group.key=" takes the key away"""
    for item in settings or ():
        path, equals, value = item.partition("=")
        if not equals:
            raise NamelistError(f"'{item}' is not of the form group.key=value")
        text = set_key(text, path, value if value.strip() else None)
    return text
