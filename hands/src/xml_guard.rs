//! What an XML text must satisfy before it reaches a parser: bounded in size, depth and number of
//! elements, and without a document type (no entities, so nothing expands and nothing is fetched).
//!
//! Parsers and their documents recurse over elements, so depth is bounded here, in one flat pass.

/// Largest URDF, bytes.
pub(crate) const MAX_BYTES: usize = 2 * 1024 * 1024;
/// Deepest nesting; a URDF needs about six.
const MAX_DEPTH: usize = 32;
/// Most elements.
const MAX_ELEMENTS: usize = 20_000;

/// Checks the text; says what was found and what was expected.
pub(crate) fn check(text: &str) -> Result<(), (String, String)> {
    if text.len() > MAX_BYTES {
        return Err((format!("{} bytes", text.len()), format!("at most {MAX_BYTES} bytes")));
    }
    let mut rest = text;
    let mut depth = 0_usize;
    let mut elements = 0_usize;
    while let Some(start) = rest.find('<') {
        rest = &rest[start + 1..];
        if let Some(tail) = rest.strip_prefix("!--") {
            rest = after(tail, "-->").ok_or_else(|| unfinished("comment"))?;
        } else if let Some(tail) = rest.strip_prefix("![CDATA[") {
            rest = after(tail, "]]>").ok_or_else(|| unfinished("CDATA section"))?;
        } else if rest.starts_with('!') {
            return Err((
                "a document type or entity declaration".into(),
                "plain elements: declarations can expand without bound or name outside files".into(),
            ));
        } else if let Some(tail) = rest.strip_prefix('?') {
            rest = after(tail, "?>").ok_or_else(|| unfinished("processing instruction"))?;
        } else {
            let closing = rest.starts_with('/');
            let end = tag_end(rest).ok_or_else(|| unfinished("tag"))?;
            let empty = rest[..end].ends_with('/');
            rest = &rest[end + 1..];
            if closing {
                depth = depth.checked_sub(1).ok_or_else(|| {
                    ("a closing tag without its opening tag".to_owned(), "balanced tags".to_owned())
                })?;
                continue;
            }
            elements += 1;
            if elements > MAX_ELEMENTS {
                return Err((
                    format!("more than {MAX_ELEMENTS} elements"),
                    format!("at most {MAX_ELEMENTS}"),
                ));
            }
            if !empty {
                depth += 1;
                if depth > MAX_DEPTH {
                    return Err((
                        format!("elements nested deeper than {MAX_DEPTH}"),
                        format!("at most {MAX_DEPTH} levels"),
                    ));
                }
            }
        }
    }
    if depth == 0 { Ok(()) } else { Err(unfinished("element")) }
}

fn after<'a>(text: &'a str, mark: &str) -> Option<&'a str> {
    text.find(mark).map(|at| &text[at + mark.len()..])
}

/// Position of the `>` that ends a tag; `>` inside quotes does not.
pub(crate) fn tag_end(text: &str) -> Option<usize> {
    let mut quote = None;
    for (at, byte) in text.bytes().enumerate() {
        match (quote, byte) {
            (None, b'>') => return Some(at),
            (None, b'"' | b'\'') => quote = Some(byte),
            (Some(q), b) if b == q => quote = None,
            _ => {}
        }
    }
    None
}

fn unfinished(what: &str) -> (String, String) {
    (format!("an unfinished {what}"), "well-formed XML".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn accepts_plain_documents() {
        check(r#"<?xml version="1.0"?><!-- a > b --><robot name="a>b"><link name="x"/></robot>"#).unwrap();
    }

    #[test]
    fn refuses_entities_depth_and_unbalanced_tags() {
        assert!(check("<!DOCTYPE a [<!ENTITY x \"y\">]><robot/>").is_err());
        assert!(check("<robot></robot></robot>").is_err());
        assert!(check("<robot>").is_err());
        assert!(check("<robot").is_err());
        let deep = "<a>".repeat(100_000) + &"</a>".repeat(100_000);
        assert!(check(&deep).unwrap_err().0.contains("nested"));
        assert!(check(&("<r>".to_owned() + &"<a/>".repeat(30_000) + "</r>")).is_err());
    }
}
