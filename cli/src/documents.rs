//! What the documents say holds: links lead somewhere, pictures are there, and commands in them are commands.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use clap::Parser as _;

use crate::Cli;

/// Folders that are not ours.
const SKIPPED: [&str; 3] = ["target", ".git", "node_modules"];

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..").canonicalize().unwrap()
}

/// Every Markdown file by its path.
fn documents() -> BTreeMap<PathBuf, String> {
    let (mut found, mut folders) = (BTreeMap::new(), vec![root()]);
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            let name = path.file_name().unwrap().to_string_lossy().into_owned();
            if path.is_dir() {
                if !SKIPPED.contains(&name.as_str()) && !name.starts_with('.') {
                    folders.push(path);
                }
            } else if name.ends_with(".md") {
                found.insert(path.clone(), std::fs::read_to_string(&path).unwrap());
            }
        }
    }
    found
}

/// Lines outside of code blocks, and the blocks by their language.
fn split(text: &str) -> (Vec<&str>, Vec<(&str, Vec<&str>)>) {
    let (mut prose, mut blocks) = (Vec::new(), Vec::<(&str, Vec<&str>)>::new());
    let mut is_code = false;
    for line in text.lines() {
        if let Some(language) = line.trim_start().strip_prefix("```") {
            is_code = !is_code;
            if is_code {
                blocks.push((language.trim(), Vec::new()));
            }
        } else if is_code {
            blocks.last_mut().unwrap().1.push(line);
        } else {
            prose.push(line);
        }
    }
    (prose, blocks)
}

/// A line without its inline code, in which brackets are no links.
fn without_code(line: &str) -> String {
    line.split('`').step_by(2).collect::<Vec<_>>().join("x")
}

/// Targets of links and pictures.
fn links(line: &str) -> Vec<String> {
    let line = without_code(line);
    let targets = line.split("](").skip(1).filter_map(|rest| rest.split_once(')'));
    targets.map(|(target, _)| target.split(' ').next().unwrap_or_default().to_owned()).collect()
}

/// A heading as forges make an anchor of it.
fn anchor(heading: &str) -> String {
    let heading = heading.trim_start_matches('#').trim().to_lowercase();
    let kept = heading.chars().filter(|c| c.is_alphanumeric() || matches!(c, ' ' | '-' | '_'));
    kept.map(|c| if c == ' ' { '-' } else { c }).collect()
}

fn anchors(text: &str) -> BTreeSet<String> {
    let (prose, _) = split(text);
    let mut found = BTreeSet::new();
    for heading in prose.iter().filter(|line| line.starts_with('#')) {
        let base = anchor(heading);
        // Headings of the same words are counted.
        let numbered = (1..).map(|n| format!("{base}-{n}"));
        let free = std::iter::once(base.clone()).chain(numbered).find(|a| !found.contains(a));
        found.extend(free);
    }
    found
}

#[test]
fn links_lead_somewhere() {
    let documents = documents();
    assert!(documents.len() > 20, "{}", documents.len());
    let (mut wrong, mut count) = (Vec::new(), 0);
    for (path, text) in &documents {
        for target in split(text).0.iter().flat_map(|line| links(line)) {
            if target.contains("://") || target.starts_with("mailto:") {
                continue;
            }
            count += 1;
            let (file, anchor) =
                target.split_once('#').map_or((target.as_str(), None), |(f, a)| (f, Some(a)));
            let to = if file.is_empty() { path.clone() } else { path.parent().unwrap().join(file) };
            let Ok(to) = to.canonicalize() else {
                wrong.push(format!("{}: {target} is not there", path.display()));
                continue;
            };
            if let (Some(anchor), Some(text)) = (anchor, documents.get(&to))
                && !anchors(text).contains(anchor)
            {
                wrong.push(format!("{}: {target} has no such heading", path.display()));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert!(count > 60, "{count}");
}

/// Words of a command as a shell splits it.
fn shell_words(command: &str) -> Vec<String> {
    let (mut words, mut word, mut quote) = (Vec::new(), None::<String>, None);
    for c in command.chars() {
        match (quote, c) {
            (Some(q), c) if c == q => quote = None,
            // What another command says is one word here.
            (None, '(') if word.as_ref().is_some_and(|w| w.ends_with('$')) => quote = Some(')'),
            (Some(_), c) => word.get_or_insert_default().push(c),
            (None, '\'' | '"') => {
                quote = Some(c);
                word.get_or_insert_default();
            }
            (None, '#') if word.is_none() => break,
            (None, c) if c.is_whitespace() => words.extend(word.take()),
            (None, c) => word.get_or_insert_default().push(c),
        }
    }
    words.extend(word);
    words
}

/// The arguments of every call of graspd in a shell block.
fn calls(lines: &[&str]) -> Vec<Vec<String>> {
    let script = lines.join("\n").replace("\\\n", " ");
    let mut found = Vec::new();
    for line in script.lines() {
        let words = shell_words(line);
        // One command of several in a line, or behind others.
        for command in words.split(|w| matches!(w.as_str(), "&&" | "||" | "|" | ";" | "&")) {
            let command: Vec<String> =
                command.iter().skip_while(|w| w.contains('=') && !w.starts_with('-')).cloned().collect();
            let mut words = command.iter().map(String::as_str);
            let arguments = match words.next() {
                Some("graspd" | "target/release/graspd" | "target/debug/graspd") => {
                    Some(words.collect::<Vec<_>>())
                }
                Some("cargo") if words.next() == Some("run") => {
                    let own = words.clone().take_while(|w| *w != "--").any(|w| w == "-p" || w == "--example");
                    let rest: Vec<&str> = words.skip_while(|w| *w != "--").skip(1).collect();
                    (!own && !rest.is_empty()).then_some(rest)
                }
                _ => None,
            };
            let until = |w: &&str| !matches!(*w, ">" | ">>" | "2>" | "<");
            found.extend(arguments.map(|all| all.into_iter().take_while(until).map(str::to_owned).collect()));
        }
    }
    found
}

// A smaller program has fewer commands.
#[cfg(feature = "sim")]
#[test]
fn commands_in_documents_are_commands() {
    let (mut wrong, mut count) = (Vec::new(), 0);
    for (path, text) in documents() {
        for (language, lines) in split(&text).1 {
            if !matches!(language, "sh" | "bash" | "console") {
                continue;
            }
            for arguments in calls(&lines) {
                // An ellipsis stands for what a reader fills in.
                if arguments.iter().any(|a| a.contains('…') || a == "...") {
                    continue;
                }
                count += 1;
                let all = std::iter::once("graspd".to_owned()).chain(arguments.iter().cloned());
                match Cli::try_parse_from(all) {
                    Ok(_) => {}
                    Err(error) if !error.use_stderr() => {}
                    Err(error) => {
                        wrong.push(format!("{}: graspd {}\n{error}", path.display(), arguments.join(" ")))
                    }
                }
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert!(count > 30, "{count}");
}

/// What a command in prose says that the program does not know: `graspd eval clear --seed N`, `graspd cell run | replay`.
#[cfg(feature = "sim")]
fn unknown_in(command: &str) -> Option<String> {
    use clap::CommandFactory as _;

    let mut root = Cli::command();
    root.build();
    let (mut parent, mut at) = (&root, &root);
    for word in command.split_whitespace().skip(1).map(|w| w.trim_matches(['[', ']', ','])) {
        if word == "|" {
            at = parent;
        } else if let Some(long) = word.strip_prefix("--") {
            let long = long.split('=').next().unwrap_or_default();
            let known = at.get_arguments().any(|a| a.get_long() == Some(long)) || long == "help";
            if !known {
                return Some(format!("{word} of graspd {}", at.get_name()));
            }
        } else if let Some(inner) = at.find_subcommand(word) {
            (parent, at) = (at, inner);
        } else if at.has_subcommands() {
            return Some(word.to_owned());
        }
    }
    None
}

#[cfg(feature = "sim")]
#[test]
fn commands_in_prose_are_commands() {
    let (mut wrong, mut count) = (Vec::new(), 0);
    for (path, text) in documents() {
        for code in split(&text).0.iter().flat_map(|line| line.split('`').skip(1).step_by(2)) {
            if code.starts_with("graspd ") {
                count += 1;
                wrong.extend(unknown_in(code).map(|what| format!("{}: `{code}`: {what}", path.display())));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert!(count > 80, "{count}");
    assert_eq!(unknown_in("graspd cell run | replay"), None);
    assert_eq!(unknown_in("graspd eval clear --seed N [--estimator geometric|learned]"), None);
    assert_eq!(unknown_in("graspd eval clean"), Some("clean".to_owned()));
    assert_eq!(unknown_in("graspd replay --seed 1"), Some("--seed of graspd replay".to_owned()));
}

#[test]
fn the_book_has_every_document() {
    let docs = root().join("docs");
    let summary = std::fs::read_to_string(docs.join("SUMMARY.md")).unwrap();
    let named: BTreeSet<PathBuf> = (summary.lines().flat_map(links))
        .map(|target| docs.join(&target).canonicalize().unwrap_or_else(|e| panic!("{target}: {e}")))
        .collect();
    let there =
        documents().into_keys().filter(|path| path.starts_with(&docs) && !path.ends_with("SUMMARY.md"));
    let missing: Vec<_> = there.filter(|path| !named.contains(path)).collect();
    assert!(missing.is_empty(), "not in docs/SUMMARY.md: {missing:?}");
}

#[test]
fn the_checks_see_what_is_wrong() {
    assert_eq!(links("a [b](c.md#d) `[no](x)` ![p](q.png \"t\")"), ["c.md#d", "q.png"]);
    let set = anchors("# A, b\n```sh\n# not this\n```\n## Score: 0.5?\n## A b");
    assert_eq!(set, ["a-b", "a-b-1", "score-05"].map(str::to_owned).into());
    assert_eq!(shell_words("a 'b c' --d $(e f) \"\" #g"), ["a", "b c", "--d", "$e f", ""]);
    let block = [
        "graspd serve --listen \\",
        "  127.0.0.1:1 & # now",
        "X=1 graspd hands list | head",
        "cargo run --release -- demo",
    ];
    let found = calls(&block);
    assert_eq!(found, [vec!["serve", "--listen", "127.0.0.1:1"], vec!["hands", "list"], vec!["demo"]]);
    assert!(Cli::try_parse_from(["graspd", "serve", "--no-such-flag"]).is_err());
}
