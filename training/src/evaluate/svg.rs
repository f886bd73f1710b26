//! What every SVG picture of an evaluation needs.

/// A text as it stands in an SVG file: the three characters that mean something there are escaped.
pub fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}
