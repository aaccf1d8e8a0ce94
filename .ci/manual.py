#!/usr/bin/env python3
"""Writes man pages and shell completions from what the programs' own --help says.

  manual.py OUT PROGRAM...      writes OUT/NAME.SECTION, OUT/NAME.bash and OUT/_NAME for each program
"""
import gzip
import pathlib
import re
import subprocess
import sys

SECTIONS = {"raynest": 1, "raynestd": 8}
SUMMARIES = {"raynest": "trace rays through scenes that a daemon holds",
             "raynestd": "daemon that traces rays through scenes for clients"}
ENTRY = re.compile(r"^  (\S.*?)(?:\s{2,}(\S.*))?$")


class Help:
    """The help of a program, or of one of its commands, in parts."""

    def __init__(self, *command):
        self.command = command
        text = subprocess.run([*command, "--help"], capture_output=True, text=True, check=True).stdout
        self.groups = {}   # heading -> [(entry, text)]
        self.lines = []    # what stands outside of groups
        group = None
        for line in text.splitlines():
            entry = ENTRY.match(line)
            if re.match(r"^[A-Z][\w ]*:$", line):
                group = self.groups.setdefault(line[:-1], [])
            elif group is not None and entry:
                group.append([entry[1], entry[2] or ""])
            elif group is not None and line.startswith("   ") and group:
                group[-1][1] = (group[-1][1] + " " + line.strip()).strip()
            else:
                if line.strip():
                    group = None
                self.lines.append(line)

    def entries(self, *headings):
        return [entry for heading in headings for entry in self.groups.get(heading, [])]

    def options(self):
        return [entry for heading, group in self.groups.items() for entry in group
                if heading not in ("Subcommands", "Example", "Exit codes") and entry[0].startswith("-")]

    def commands(self):
        return self.entries("Subcommands")


def flags_of(entry):
    """The names of an option: "-h,--help" and "--server TEXT (Env:X)" are two."""
    return re.findall(r"(?<![\w-])--?[A-Za-z][\w-]*", entry[0].split(" ")[0])


def roff(text):
    return re.sub(r"^([.'])", r"\\&\1", text.replace("\\", "\\e").replace("-", "\\-"))


def man_page(name, version, whole, commands):
    lines = [f'.TH {name.upper()} {SECTIONS[name]} "" "RayNest {version}"', ".SH NAME",
             f"{name} \\- {SUMMARIES[name]}", ".SH SYNOPSIS", f".B {name}",
             "[OPTIONS] [COMMAND [OPTIONS]]", ".SH DESCRIPTION"]
    lines += [roff(line.strip()) for line in whole.lines
              if line.strip() and not line.startswith(("Usage", "Example"))]

    def add_options(options):
        for entry in options:
            lines.extend([".TP", f"\\fB{roff(entry[0])}\\fR", roff(entry[1]) or "\\&"])
    lines.append(".SH OPTIONS")
    add_options(whole.options())
    if commands:
        lines.append(".SH COMMANDS")
    for command, text, shown in commands:
        lines += [f'.SS "{name} {command}"', roff(text)]
        if shown.groups.get("Example"):
            lines += [".PP", "Example:", ".nf", *(roff(entry[0]) for entry in shown.groups["Example"]),
                      ".fi"]
        add_options([entry for entry in shown.options() if "--help" not in flags_of(entry)])
    codes = whole.entries("Exit codes")
    if codes:
        lines.append(".SH EXIT STATUS")
        for code, text in codes:
            lines += [".TP", code, roff(text)]
    other = next(program for program in SECTIONS if program != name)
    lines += [".SH SEE ALSO", f".BR {other} ({SECTIONS[other]})"]
    return "\n".join(lines) + "\n"


def choices_of(entry):
    """The values of an option or argument, as ["on", "off"] of "--tls-verify TEXT:{on,off}"; [] for
    any."""
    found = re.search(r":\{([^}]*)\}", entry[0])
    return found[1].split(",") if found else []


def takes_value(entry):
    """True for "--name TEXT", false for a flag."""
    return len(entry[0].split(" (Env:")[0].split()) > 1


def arguments_of(shown):
    """The choices of the first argument without dashes that has some."""
    entries = shown.entries("Positionals")
    return next((choices for entry in entries if (choices := choices_of(entry))), [])


def children_of(name, commands):
    """{command: its subcommands}, the program itself being ""."""
    children = {"": []}
    for command, _, _ in commands:
        parent, _, word = command.rpartition(" ")
        children.setdefault(parent, []).append(word)
        children.setdefault(command, [])
    for group in [group for group in children if group and not children[group]]:
        del children[group]
    children[""] = list(dict.fromkeys(children[""] + [group for group in children if group]))
    return children


def bash_completion(name, whole, commands):
    helps = {"": whole, **{command: shown for command, _, shown in commands}}
    children = children_of(name, commands)
    known = "|".join(f"'{command}'" for command in [*(g for g in children if g), *helps] if command)
    lines = [f"# bash completion of {name}, written from its --help", f"_{name}() {{",
             "    local word=${COMP_WORDS[COMP_CWORD]} before=${COMP_WORDS[COMP_CWORD-1]}",
             "    local command= words= value= i",
             "    for ((i = 1; i < COMP_CWORD; ++i)); do",
             '        case "${command:+$command }${COMP_WORDS[i]}" in',
             f'            {known}) command="${{command:+$command }}${{COMP_WORDS[i]}}" ;;',
             "        esac", "    done", '    case "$command" in']
    for command in dict.fromkeys([*helps, *children]):
        shown = helps.get(command)
        words = [flag for entry in (shown.options() if shown else []) for flag in flags_of(entry)
                 if flag.startswith("--")]
        words += children.get(command, []) + (arguments_of(shown) if shown else [])
        lines.append(f"        '{command}') words='{' '.join(words)}' ;;")
    lines += ["    esac", '    case "$command $before" in']
    for command, shown in helps.items():
        for entry in shown.options():
            if not takes_value(entry):
                continue
            pattern = "|".join(f"'{command} {flag}'" for flag in flags_of(entry))
            lines.append(f"        {pattern}) value=1 words='{' '.join(choices_of(entry))}' ;;")
    lines += ["    esac",
              "    # An empty word stands for a command, a value or a file, not for an option.",
              "    [[ $word == -* || $value ]] || words=$(printf '%s\\n' $words | grep -v ^-)",
              "    mapfile -t COMPREPLY < <(compgen -W \"$words\" -- \"$word\")",
              "    ((${#COMPREPLY[@]})) || mapfile -t COMPREPLY < <(compgen -f -- \"$word\")", "}",
              f"complete -o filenames -F _{name} {name}", ""]
    return "\n".join(lines)


def zsh_completion(name, whole, commands):
    helps = {"": whole, **{command: shown for command, _, shown in commands}}
    children = children_of(name, commands)
    texts = {command: text for command, text, _ in commands}

    def quoted(text):
        for plain, safe in (("'", "'\\''"), ("[", "("), ("]", ")"), (":", "\\:")):
            text = text.replace(plain, safe)
        return text

    def specs(shown):
        found = []
        for entry in shown.options():
            choices = choices_of(entry)
            value = f":value:({' '.join(choices)})" if choices else ":value:_files"
            found += [f"'{flag}[{quoted(entry[1])}]{value if takes_value(entry) else ''}'"
                      for flag in flags_of(entry) if flag.startswith("--")]
        return found
    known = "|".join(re.escape(command) for command in [*(g for g in children if g), *helps]
                     if command)
    lines = [f"#compdef {name}", f"# zsh completion of {name}, written from its --help",
             "local command= word", "local -a below",
             "for word in $words[2,CURRENT-1]; do",
             '    case "${command:+$command }$word" in',
             f'        {known}) command="${{command:+$command }}$word" ;;', "    esac", "done",
             'case "$command" in']
    for command in dict.fromkeys([*helps, *children]):
        below = [f"'{word}:{quoted(texts.get(f'{command} {word}'.strip(), ''))}'"
                 for word in children.get(command, [])]
        shown = helps.get(command)
        choices = arguments_of(shown) if shown else []
        rest = f"'*:argument:({' '.join(choices)})'" if choices else "'*:file:_files'"
        parts = [f"below=({' '.join(below)}); _describe command below"] if below else []
        if shown and below:
            parts.append(f"[[ $PREFIX == -* ]] && _arguments {' '.join(specs(shown))}")
        elif shown:
            parts.append(f"_arguments {' '.join(specs(shown))} {rest}")
        lines.append(f"    '{command}') {'; '.join(parts)} ;;")
    return "\n".join([*lines, "esac", ""])


def main():
    out = pathlib.Path(sys.argv[1])
    out.mkdir(parents=True, exist_ok=True)
    for program in sys.argv[2:]:
        name = pathlib.Path(program).name
        version = subprocess.run([program, "--version"], capture_output=True, text=True,
                                 check=True).stdout.split()[-1]
        whole = Help(program)
        commands = [(command, text, Help(program, command)) for command, text in whole.commands()]
        if name == "raynestd":  # its commands are described in their own help
            for group, verbs in (("tls", ("init", "renew")), ("token", ("add", "list", "revoke"))):
                for verb in verbs:
                    shown = Help(program, group, verb)
                    commands.append((f"{group} {verb}", shown.lines[0] if shown.lines else "", shown))
        page = man_page(name, version, whole, commands)
        (out / f"{name}.{SECTIONS[name]}").write_text(page, encoding="utf-8")
        # Packages hold them packed; without a time in the file, equal pages are equal files.
        (out / f"{name}.{SECTIONS[name]}.gz").write_bytes(gzip.compress(page.encode(), mtime=0))
        (out / f"{name}.bash").write_text(bash_completion(name, whole, commands), encoding="utf-8")
        (out / f"_{name}").write_text(zsh_completion(name, whole, commands), encoding="utf-8")


if __name__ == "__main__":
    main()
