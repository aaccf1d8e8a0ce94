#!/usr/bin/env python3
"""Writes man pages and shell completions from what the programs' own --help says.

  manual.py OUT PROGRAM...      writes OUT/NAME.SECTION, OUT/NAME.bash and OUT/_NAME for each program
"""
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


def bash_completion(name, whole, commands):
    def words(shown):
        return " ".join(flag for entry in shown.options() for flag in flags_of(entry)
                        if flag.startswith("--"))
    cases = [f"        {command}) words='{words(shown)}' ;;" for command, _, shown in commands]
    top = " ".join([words(whole), *(command for command, _, _ in commands)])
    return "\n".join([
        f"# bash completion of {name}, written from its --help", f"_{name}() {{",
        "    local word=${COMP_WORDS[COMP_CWORD]} words='" + top + "' i",
        "    for ((i = 1; i < COMP_CWORD; ++i)); do", "        case ${COMP_WORDS[i]} in", *cases,
        "        esac", "    done",
        "    [[ $word == -* || $COMP_CWORD -eq 1 ]] &&",
        "        mapfile -t COMPREPLY < <(compgen -W \"$words\" -- \"$word\")",
        "    ((${#COMPREPLY[@]})) || mapfile -t COMPREPLY < <(compgen -f -- \"$word\")", "}",
        f"complete -o filenames -F _{name} {name}", ""])


def zsh_completion(name, whole, commands):
    def quoted(text):
        return text.replace("'", "'\\''").replace("[", "(").replace("]", ")").replace(":", "\\:")

    def specs(shown):
        return [f"'{flag}[{quoted(entry[1])}]'" for entry in shown.options()
                for flag in flags_of(entry) if flag.startswith("--")]
    lines = [f"#compdef {name}", f"# zsh completion of {name}, written from its --help", "local -a commands",
             "commands=(" + " ".join(f"'{command}:{quoted(text)}'" for command, text, _ in commands) + ")",
             "local word", "for word in $words[2,CURRENT-1]; do", "    case $word in"]
    for command, _, shown in commands:
        lines.append(f"        {command}) _arguments {' '.join(specs(shown))} '*:file:_files'; return ;;")
    lines += ["    esac", "done", "(( CURRENT == 2 )) && _describe command commands",
              f"_arguments {' '.join(specs(whole))} '*:file:_files'", ""]
    return "\n".join(lines)


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
        (out / f"{name}.{SECTIONS[name]}").write_text(man_page(name, version, whole, commands),
                                                      encoding="utf-8")
        (out / f"{name}.bash").write_text(bash_completion(name, whole, commands), encoding="utf-8")
        (out / f"_{name}").write_text(zsh_completion(name, whole, commands), encoding="utf-8")


if __name__ == "__main__":
    main()
