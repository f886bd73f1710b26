//! The files of the page, in the program itself: nothing is read from a disk, and nothing from another server.

/// A file of the page.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct File {
    /// Path of its URL.
    pub(super) path: &'static str,
    /// Content type.
    pub(super) kind: &'static str,
    /// Bytes.
    pub(super) bytes: &'static [u8],
}

const SCRIPT: &str = "text/javascript; charset=utf-8";

macro_rules! script {
    ($name:literal) => {
        File { path: concat!("/page/", $name), kind: SCRIPT, bytes: include_bytes!(concat!("web/", $name)) }
    };
}

/// Every file that there is.
pub(super) const FILES: [File; 19] = [
    File { path: "/", kind: "text/html; charset=utf-8", bytes: include_bytes!("web/index.html") },
    File { path: "/page/style.css", kind: "text/css; charset=utf-8", bytes: include_bytes!("web/style.css") },
    File { path: "/page/icon.svg", kind: "image/svg+xml", bytes: include_bytes!("web/icon.svg") },
    script!("main.js"),
    script!("schema.js"),
    script!("wire.js"),
    script!("call.js"),
    script!("matrix.js"),
    script!("gl.js"),
    script!("view.js"),
    script!("surface.js"),
    script!("hand.js"),
    script!("mcap.js"),
    script!("frame.js"),
    script!("elements.js"),
    script!("hands_panel.js"),
    script!("grasp_panel.js"),
    script!("status.js"),
    script!("colors.js"),
];

/// The file at a path.
pub(super) fn file(path: &str) -> Option<&'static File> {
    FILES.iter().find(|file| file.path == path)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    fn text(file: &File) -> &str {
        std::str::from_utf8(file.bytes).unwrap()
    }

    #[test]
    fn every_file_of_the_folder_is_served_and_begins_with_what_it_is_for() {
        let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("src/page/web");
        let found: BTreeSet<String> = (std::fs::read_dir(folder).unwrap())
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        let served: BTreeSet<String> =
            FILES.iter().map(|f| f.path.strip_prefix("/page/").unwrap_or("index.html").to_owned()).collect();
        assert_eq!(found, served);
        for file in &FILES {
            let first = text(file).lines().next().unwrap();
            assert!(["// ", "/* ", "<!-- "].iter().any(|mark| first.starts_with(mark)), "{}", file.path);
        }
    }

    #[test]
    fn nothing_comes_from_elsewhere_and_nothing_is_inline() {
        for file in &FILES {
            let text = text(file);
            // Names of XML namespaces are no addresses.
            let text = text.replace("http://www.w3.org/2000/svg", "");
            for elsewhere in ["http://", "https://", "@import", "eval(", "innerHTML", "document.write"] {
                assert!(!text.contains(elsewhere), "{}: {elsewhere}", file.path);
            }
        }
        let page = text(file("/").unwrap());
        for inline in ["<style", "style=", "onclick", "onload", "javascript:"] {
            assert!(!page.contains(inline), "{inline}");
        }
        assert_eq!(page.matches("<script").count(), page.matches("<script type=\"module\" src=").count());
    }

    #[test]
    fn scripts_import_only_files_that_there_are() {
        let mut imports = 0;
        for file in FILES.iter().filter(|f| f.kind == SCRIPT) {
            for line in text(file).lines().filter(|l| l.starts_with("import ")) {
                let name = line.split('"').nth(1).unwrap().strip_prefix("./").unwrap();
                assert!(super::file(&format!("/page/{name}")).is_some(), "{}: {line}", file.path);
                imports += 1;
            }
        }
        assert!(imports > 10);
    }
}
