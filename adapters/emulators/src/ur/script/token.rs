//! Tokens of URScript.

/// One token.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Token {
    /// A name or keyword.
    Name(String),
    /// A whole number.
    Int(i32),
    /// A number with a point or exponent.
    Float(f64),
    /// Text in quotes.
    Text(String),
    /// Operators and brackets.
    Sign(&'static str),
}

/// A token and where it stands.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Placed {
    pub(crate) token: Token,
    /// From 1.
    pub(crate) line: u32,
}

/// Why a script is not one.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("line {line}: {what}")]
pub struct ScriptError {
    /// Line, from 1.
    pub line: u32,
    /// What was found, what was expected.
    pub what: String,
}

const SIGNS: [&str; 21] = [
    "==", "!=", "<=", ">=", "=", "<", ">", "+", "-", "*", "/", "%", "(", ")", "[", "]", ",", ":", ";", ".",
    "^",
];

/// Splits a script.
pub(crate) fn tokens(text: &str) -> Result<Vec<Placed>, ScriptError> {
    let mut out = Vec::new();
    for (number, line) in text.lines().enumerate() {
        let line_number = u32::try_from(number + 1).unwrap_or(u32::MAX);
        let place = |token| Placed { token, line: line_number };
        let wrong = |what: String| ScriptError { line: line_number, what };
        let mut rest = line;
        loop {
            rest = rest.trim_start();
            let Some(first) = rest.chars().next() else { break };
            if first == '#' {
                break;
            }
            if first == '"' || first == '\'' {
                let inner = &rest[1..];
                let end = inner.find(first).ok_or_else(|| wrong("text without closing quote".into()))?;
                out.push(place(Token::Text(inner[..end].to_owned())));
                rest = &inner[end + 1..];
                continue;
            }
            if first.is_ascii_alphabetic() || first == '_' {
                let end = rest.find(|c: char| !(c.is_ascii_alphanumeric() || c == '_')).unwrap_or(rest.len());
                out.push(place(Token::Name(rest[..end].to_owned())));
                rest = &rest[end..];
                continue;
            }
            if first.is_ascii_digit() || (first == '.' && rest[1..].starts_with(|c: char| c.is_ascii_digit()))
            {
                let end = number_end(rest);
                let word = &rest[..end];
                let token = match word.parse::<i32>() {
                    Ok(whole) => Token::Int(whole),
                    Err(_) => {
                        Token::Float(word.parse().map_err(|_| wrong(format!("`{word}` is not a number")))?)
                    }
                };
                out.push(place(token));
                rest = &rest[end..];
                continue;
            }
            let sign = SIGNS.iter().find(|s| rest.starts_with(**s));
            let sign = sign.ok_or_else(|| wrong(format!("unexpected character {first:?}")))?;
            out.push(place(Token::Sign(sign)));
            rest = &rest[sign.len()..];
        }
    }
    Ok(out)
}

/// Where a number at the start of a text ends.
fn number_end(text: &str) -> usize {
    let bytes = text.as_bytes();
    let digits = |mut at: usize| {
        while bytes.get(at).is_some_and(u8::is_ascii_digit) {
            at += 1;
        }
        at
    };
    let mut at = digits(0);
    if bytes.get(at) == Some(&b'.') {
        at = digits(at + 1);
    }
    if matches!(bytes.get(at), Some(b'e' | b'E')) {
        let signed = at + 1 + usize::from(matches!(bytes.get(at + 1), Some(b'+' | b'-')));
        let end = digits(signed);
        if end > signed {
            at = end;
        }
    }
    at
}

/// Splits what comes in on a socket into programs: a `def` or `sec` up to its `end`, or a line on its own.
#[derive(Debug, Default)]
pub(crate) struct Splitter {
    lines: Vec<String>,
    depth: i64,
    partial: Vec<u8>,
    size: usize,
}

/// Longest program that is accepted, bytes.
const LONGEST: usize = 1 << 20;

impl Splitter {
    /// Takes bytes, gives the programs that are complete.
    ///
    /// # Errors
    /// Nothing is one when a program is longer than a megabyte or not text; what came so far is dropped.
    pub(crate) fn push(&mut self, bytes: &[u8]) -> Result<Vec<String>, ScriptError> {
        let mut programs = Vec::new();
        for &byte in bytes {
            if byte != b'\n' {
                self.size += 1;
                if self.size > LONGEST {
                    *self = Self::default();
                    return Err(ScriptError { line: 0, what: "a program of more than a megabyte".into() });
                }
                self.partial.push(byte);
                continue;
            }
            let line = String::from_utf8_lossy(&std::mem::take(&mut self.partial)).into_owned();
            self.depth += opened(&line);
            self.lines.push(line);
            if self.depth <= 0 {
                let program = std::mem::take(self).lines.join("\n");
                if !program.trim().is_empty() {
                    programs.push(program);
                }
            }
        }
        Ok(programs)
    }
}

/// Blocks that a line opens, less those that it closes.
fn opened(line: &str) -> i64 {
    let Ok(tokens) = tokens(line) else { return 0 };
    let weigh = |placed: &Placed| match &placed.token {
        Token::Name(name) => match name.as_str() {
            "def" | "sec" | "thread" | "if" | "while" => 1,
            "end" => -1,
            _ => 0,
        },
        _ => 0,
    };
    tokens.iter().map(weigh).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn programs_are_split_where_they_end() {
        let mut splitter = Splitter::default();
        let text = "def f():\n  if True: # end\n    textmsg(\"end\")\n  end\nend\nmovej([0,0,0,0,0,0])\n\ndef g():\n";
        let mut programs = Vec::new();
        for byte in text.bytes() {
            programs.extend(splitter.push(&[byte]).unwrap());
        }
        assert_eq!(programs.len(), 2);
        assert!(programs[0].ends_with("end") && programs[1].starts_with("movej"));
        assert_eq!(splitter.push(b"end\n").unwrap(), ["def g():\nend"]);
    }

    #[test]
    fn numbers_are_read_in_every_notation() {
        let found: Vec<Token> =
            tokens("1 2.5 1e-3 .5 3.e2 7").unwrap().into_iter().map(|p| p.token).collect();
        let expected = [
            Token::Int(1),
            Token::Float(2.5),
            Token::Float(1e-3),
            Token::Float(0.5),
            Token::Float(300.0),
            Token::Int(7),
        ];
        assert_eq!(found, expected);
    }

    proptest! {
        #[test]
        fn any_text_is_survived(text in ".{0,200}", bytes in prop::collection::vec(any::<u8>(), 0..200)) {
            let _ = tokens(&text);
            let _ = Splitter::default().push(&bytes);
        }
    }
}
