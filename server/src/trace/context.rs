//! W3C trace context (<https://www.w3.org/TR/trace-context/>, level 1): what a call is part of.

use tonic::codegen::http::HeaderMap;

/// What a call is part of, and the call's own span.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct TraceContext {
    pub(crate) trace_id: [u8; 16],
    /// The call's span.
    pub(crate) span_id: [u8; 8],
    /// The caller's span.
    pub(crate) parent: Option<[u8; 8]>,
    /// Somebody wants to see it.
    pub(crate) is_sampled: bool,
}

impl TraceContext {
    /// The context that a call brings, or a new one where it brings none that is valid.
    pub(crate) fn of_call(headers: &HeaderMap) -> Self {
        // More than one header is not valid.
        let mut all = headers.get_all("traceparent").iter();
        let given = all.next().filter(|_| all.next().is_none());
        Self::of_text(given.and_then(|value| value.to_str().ok()))
    }

    /// The same of the header's value.
    pub(crate) fn of_text(traceparent: Option<&str>) -> Self {
        let span_id = crate::random::bytes();
        match traceparent.and_then(parse) {
            Some((trace_id, parent, is_sampled)) => {
                Self { trace_id, span_id, parent: Some(parent), is_sampled }
            }
            None => Self { trace_id: crate::random::bytes(), span_id, parent: None, is_sampled: true },
        }
    }

    /// The header's value for what is part of this call's span.
    pub(crate) fn traceparent(&self) -> String {
        let span: String = self.span_id.iter().map(|byte| format!("{byte:02x}")).collect();
        format!("00-{}-{span}-{:02x}", self.id_text(), u8::from(self.is_sampled))
    }

    /// The trace's id, 32 hexadecimal digits.
    pub(crate) fn id_text(&self) -> String {
        self.trace_id.iter().map(|byte| format!("{byte:02x}")).collect()
    }
}

/// Trace id, parent's span id and whether it is sampled.
fn parse(text: &str) -> Option<([u8; 16], [u8; 8], bool)> {
    let mut parts = text.split('-');
    let [version] = hex::<1>(parts.next()?)?;
    let trace_id = hex::<16>(parts.next()?)?;
    let parent = hex::<8>(parts.next()?)?;
    let [flags] = hex::<1>(parts.next()?)?;
    // Later versions may have more parts, the first has not.
    let in_order = version != 0xff && (version != 0 || parts.next().is_none());
    (in_order && trace_id != [0; 16] && parent != [0; 8]).then_some((trace_id, parent, flags & 1 == 1))
}

/// Exactly these bytes, as lower-case digits.
fn hex<const N: usize>(text: &str) -> Option<[u8; N]> {
    let mut bytes = [0; N];
    let sane = text.len() == 2 * N && text.bytes().all(|b| matches!(b, b'0'..=b'9' | b'a'..=b'f'));
    for (i, byte) in bytes.iter_mut().enumerate() {
        *byte = u8::from_str_radix(text.get(2 * i..2 * i + 2).filter(|_| sane)?, 16).ok()?;
    }
    Some(bytes)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const GIVEN: &str = "00-4bf92f3577b34da6a3ce929d0e0e4736-00f067aa0ba902b7-01";

    fn of(value: &str) -> TraceContext {
        let mut headers = HeaderMap::new();
        headers.insert("traceparent", value.parse().unwrap());
        TraceContext::of_call(&headers)
    }

    #[test]
    fn a_context_is_taken_as_the_recommendation_says() {
        let context = of(GIVEN);
        assert_eq!(context.id_text(), "4bf92f3577b34da6a3ce929d0e0e4736");
        assert_eq!(context.parent, Some([0x00, 0xf0, 0x67, 0xaa, 0x0b, 0xa9, 0x02, 0xb7]));
        assert!(context.is_sampled && context.span_id != [0; 8]);
        assert!(!of(&GIVEN.replace("-01", "-00")).is_sampled);
        let next = TraceContext::of_text(Some(&context.traceparent()));
        assert_eq!((next.trace_id, next.parent), (context.trace_id, Some(context.span_id)));
        // A later version with more to say.
        assert!(of("cc-4bf92f3577b34da6a3ce929d0e0e4736-00f067aa0ba902b7-01-what").parent.is_some());
        for wrong in [
            "",
            "00",
            "ff-4bf92f3577b34da6a3ce929d0e0e4736-00f067aa0ba902b7-01",
            "00-4bf92f3577b34da6a3ce929d0e0e4736-00f067aa0ba902b7-01-more",
            "00-00000000000000000000000000000000-00f067aa0ba902b7-01",
            "00-4bf92f3577b34da6a3ce929d0e0e4736-0000000000000000-01",
            "00-4BF92F3577B34DA6A3CE929D0E0E4736-00f067aa0ba902b7-01",
            "00-4bf92f3577b34da6a3ce929d0e0e473-00f067aa0ba902b7-01",
        ] {
            let context = of(wrong);
            assert!(context.parent.is_none() && context.is_sampled && context.trace_id != [0; 16], "{wrong}");
        }
    }

    proptest! {
        #[test]
        fn any_header_is_a_context_or_none(text in "[ -~]{0,80}") {
            parse(&text);
        }
    }
}
