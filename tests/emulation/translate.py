#!/usr/bin/env python3
"""Turns the CUDA sources of a reference into C++ that tests/emulation/include/cuda_runtime.h understands.

    translate.py --root ROOT [--root ROOT ...] --out FOLDER --depfile FILE SOURCE

SOURCE and every file under references/ or tests/ that it includes are written to FOLDER under the same relative path
(SOURCE with .cpp appended). A file is looked for in the roots in turn: mutants put their patched copies first. Only what
a macro cannot do is changed here, and no line moves:
  kernel<<<grid, block>>>(arguments)   (::emulation::config(grid, block) << [&](const auto&... a) { kernel(a...); })(arguments)
  extern __shared__ T name[];          T* const name = ::emulation::dynamic_shared<T>();
  asm("ptx" : outs : ins);             ::emulation::ptx<"ptx">(outs, ins);
  __noinline__                         an attribute; as a macro it would break the standard library
"""
import argparse
import os
import re
import sys

TOKEN = re.compile(r'''
    (?P<skip>//[^\n]*|/\*.*?\*/|R"(?P<delim>[^(\s]*)\(.*?\)(?P=delim)"|"(?:\\.|[^"\\\n])*"|(?<![0-9a-fA-FxX'])'(?:\\.|[^'\\\n])+')
  | (?P<launch><<<)
  | (?P<shared>\bextern\s+(?:__align__\s*\([^)]*\)\s*|alignas\s*\([^)]*\)\s*)?__shared__\b[^;]*;)
  | (?P<asm>\b(?:asm|__asm__)\b\s*(?:volatile\b|__volatile__\b)?\s*\()
  | (?P<noinline>\b__noinline__\b)
''', re.X | re.S)
INCLUDE = re.compile(r'^[ \t]*#[ \t]*include[ \t]*"([^"]+)"', re.M)
SKIP = re.compile(r'//[^\n]*|/\*.*?\*/|"(?:\\.|[^"\\\n])*"', re.S)


def closing(text, start, where):
    """Position behind the bracket that closes the one before `start`; comments and strings do not count."""
    depth, i = 1, start
    while i < len(text):
        skip = SKIP.match(text, i)
        if skip:
            i = skip.end()
            continue
        depth += (text[i] in '([{') - (text[i] in ')]}')
        i += 1
        if depth == 0:
            return i
    sys.exit(f'{where}: a bracket is not closed')


def split(text, separator):
    """Splits at `separator` outside brackets and strings (a colon that is part of '::' does not count)."""
    parts, depth, i, begin = [], 0, 0, 0
    while i < len(text):
        skip = SKIP.match(text, i)
        if skip:
            i = skip.end()
            continue
        if separator == ':' and text.startswith('::', i) and parts and depth > 0:
            i += 2
            continue
        depth += (text[i] in '([{') - (text[i] in ')]}')
        if depth == 0 and text[i] == separator:
            parts.append(text[begin:i])
            begin = i + 1
        i += 1
    parts.append(text[begin:])
    return parts


def kernel_before(text):
    """Where the expression begins that names the kernel at the end of `text`."""
    def opening(i, close):
        depth = 0
        while i >= 0:
            depth += (text[i] in ')]}>' and not (text[i] == '>' and text[i - 1] == '-')) - (text[i] in '([{<')
            if depth == 0:
                return i
            i -= 1
        return -1

    i = len(text.rstrip())
    if text[i - 1] == ')':
        return opening(i - 1, ')')
    while True:
        if text[i - 1] == '>':
            i = opening(i - 1, '>')
            i = len(text[:i].rstrip())
        name = re.search(r'(?:template\s+)?\w+$', text[:i])
        if not name:
            return i
        i = name.start()
        qualified = re.search(r'(?:::|\.|->)$', text[:i])
        if not qualified:
            return i
        i = qualified.start()
        if not re.search(r'[\w>]$', text[:i]):
            return i  # from the global namespace


def newlines(text):
    return '\n' * text.count('\n')


def translate_asm(body):
    """`body` is what stands between the brackets."""
    sections = split(body, ':')
    template = '"' + ''.join(re.findall(r'"((?:\\.|[^"\\])*)"', sections[0])) + '"'
    operands = []
    for section in sections[1:3]:
        for operand in split(section, ','):
            match = re.match(r'\s*(?:\[\w+\]\s*)?"[^"]*"\s*\((.*)\)\s*$', operand, re.S)
            if match:
                operands.append(' '.join(match.group(1).split()))
    return f'::emulation::ptx<{template}>({", ".join(operands)}){newlines(body)}'


def translate_shared(text, where):
    match = re.match(r'extern\s+(.*?)__shared__\s+(.*?)(\w+)\s*\[\s*\]\s*;$', text, re.S)
    if not match:
        sys.exit(f'{where}: not understood: {text}')
    kind = re.sub(r'__align__\s*\([^)]*\)|alignas\s*\([^)]*\)', '', match.group(1) + match.group(2)).strip()
    name = match.group(3)
    return f'{kind}* const {name} = ::emulation::dynamic_shared<{kind}>();{newlines(text)}'


def translate(text, where):
    out, at = [], 0
    while True:
        match = TOKEN.search(text, at)
        if not match:
            out.append(text[at:])
            return ''.join(out)
        out.append(text[at:match.start()])
        at = match.end()
        line = f'{where}:{text.count(chr(10), 0, match.start()) + 1}'
        if match['skip'] is not None:
            out.append(match[0])
        elif match['noinline']:
            out.append('__attribute__((noinline))')
        elif match['shared']:
            out.append(translate_shared(match[0], line))
        elif match['asm']:
            end = closing(text, at, line)
            out.append(translate_asm(text[at:end - 1]))
            at = end
        else:
            end = text.find('>>>', at)
            behind = re.compile(r'>>>\s*\(').match(text, end) if end >= 0 else None
            if not behind:
                sys.exit(f'{line}: a launch is not understood')
            before = ''.join(out)
            start = kernel_before(before)
            kernel = before[start:].strip()
            out = [before[:start], f'(::emulation::config({translate(text[at:end], where)}) << [&](const auto&... a_) {{ '
                   f'{kernel}(a_...); }})(', newlines(before[start:] + behind[0])]
            at = behind.end()


def main():
    arguments = argparse.ArgumentParser()
    arguments.add_argument('--root', action='append', required=True)
    arguments.add_argument('--out', required=True)
    arguments.add_argument('--depfile')
    arguments.add_argument('source', help='relative to a root')
    a = arguments.parse_args()
    waiting, seen, read = [a.source], set(), []
    while waiting:
        name = waiting.pop()
        if name in seen:
            continue
        seen.add(name)
        path = next((p for p in (os.path.join(root, name) for root in a.root) if os.path.exists(p)), None)
        if path is None:
            continue
        path = os.path.abspath(path)
        read.append(path)
        text = open(path, encoding='utf-8').read()
        waiting += [i for i in INCLUDE.findall(text) if i.startswith(('references/', 'tests/'))]
        target = os.path.join(a.out, name + ('.cpp' if name == a.source else ''))
        os.makedirs(os.path.dirname(target), exist_ok=True)
        result = f'#line 1 "{path}"\n' + translate(text, name)
        old = open(target, encoding='utf-8').read() if os.path.exists(target) else None
        if result != old or name == a.source:
            with open(target, 'w', encoding='utf-8') as f:
                f.write(result)
    if a.depfile:
        with open(a.depfile, 'w', encoding='utf-8') as f:
            f.write(f'{os.path.join(a.out, a.source)}.cpp: ' + ' \\\n  '.join(read) + '\n')


if __name__ == '__main__':
    main()
