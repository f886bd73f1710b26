//! Which limits a URDF really states for its joints: the parser fills those that are missing with zeros.

use crate::xml_guard::tag_end;

/// What a joint's `<limit>` states.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Stated {
    /// There is a `<limit>`.
    pub(crate) limit: bool,
    /// It has `lower`.
    pub(crate) lower: bool,
    /// It has `upper`.
    pub(crate) upper: bool,
}

/// One entry for each `<joint>` of the `<robot>`, in the order of the document.
///
/// Joints elsewhere (in `<transmission>`) do not count. The text has passed [`crate::xml_guard::check`].
pub(crate) fn stated(text: &str) -> Vec<Stated> {
    let mut out: Vec<Stated> = Vec::new();
    let mut open: Vec<&str> = Vec::new();
    let mut rest = text;
    while let Some(start) = rest.find('<') {
        rest = &rest[start + 1..];
        let special = [("!--", "-->"), ("![CDATA[", "]]>"), ("?", "?>")];
        if let Some((_, end)) = special.iter().find(|(begin, _)| rest.starts_with(begin)) {
            let Some(at) = rest.find(end) else { break };
            rest = &rest[at + end.len()..];
            continue;
        }
        let Some(end) = tag_end(rest) else { break };
        let tag = &rest[..end];
        rest = &rest[end + 1..];
        if tag.starts_with('/') {
            open.pop();
            continue;
        }
        let (tag, empty) = tag.strip_suffix('/').map_or((tag, false), |tag| (tag, true));
        let (name, attributes) = tag.split_once(|c: char| c.is_ascii_whitespace()).unwrap_or((tag, ""));
        match (open.as_slice(), name) {
            ([_], "joint") => out.push(Stated::default()),
            ([_, "joint"], "limit") => {
                if let Some(last) = out.last_mut() {
                    let has = |wanted: &str| names(attributes).any(|name| name == wanted);
                    *last = Stated { limit: true, lower: has("lower"), upper: has("upper") };
                }
            }
            _ => {}
        }
        if !empty {
            open.push(name);
        }
    }
    out
}

/// The names of a tag's attributes.
fn names(mut attributes: &str) -> impl Iterator<Item = &str> {
    std::iter::from_fn(move || {
        let (name, value) = attributes.split_once('=')?;
        let value = value.trim_start();
        let quote = value.chars().next().filter(|c| matches!(c, '"' | '\''))?;
        let (_, rest) = value[1..].split_once(quote)?;
        attributes = rest;
        Some(name.trim())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tells_what_is_stated_from_what_is_missing() {
        let urdf = r#"<?xml version="1.0"?><robot name="a>b"><!-- <joint/> --><link name="x"/>
            <joint name="none" type="revolute"><axis xyz="0 0 1"/></joint>
            <joint name="both"><limit effort='1' lower = "0"
                upper='upper="1"' velocity="1"></limit></joint>
            <joint name="no_upper"><limit lower="0" note="upper=1"/></joint>
            <joint name="empty"/>
            <transmission name="t"><joint name="both"><limit lower="0" upper="1"/></joint></transmission>
            <joint name="no_lower"><limit upper="1"/></joint></robot>"#;
        let of = |limit, lower, upper| Stated { limit, lower, upper };
        assert_eq!(
            stated(urdf),
            [
                of(false, false, false),
                of(true, true, true),
                of(true, true, false),
                of(false, false, false),
                of(true, false, true)
            ]
        );
    }

    #[test]
    fn broken_texts_end() {
        for text in
            ["", "<", "<robot", "<robot><joint><limit lower=\"", "<robot><joint><limit lower=1 upper/>"]
        {
            assert!(stated(text).iter().all(|s| !s.upper), "{text}");
        }
    }
}
