//! Tables as plain text and as Markdown.

/// Rows under a header.
#[derive(Debug, Clone, Default)]
pub(crate) struct Table {
    rows: Vec<Vec<String>>,
}

impl Table {
    /// A table with this header. The first column is aligned left, the others right.
    pub(crate) fn new(header: impl IntoIterator<Item = impl Into<String>>) -> Self {
        Self { rows: vec![header.into_iter().map(Into::into).collect()] }
    }

    /// Adds a row.
    pub(crate) fn row(&mut self, cells: impl IntoIterator<Item = impl Into<String>>) {
        self.rows.push(cells.into_iter().map(Into::into).collect());
    }

    fn widths(&self) -> Vec<usize> {
        let columns = self.rows.iter().map(Vec::len).max().unwrap_or(0);
        let width = |c: usize| self.rows.iter().filter_map(|r| r.get(c)).map(|s| s.chars().count()).max();
        (0..columns).map(|c| width(c).unwrap_or(0).max(3)).collect()
    }

    fn lines(&self, between: &str) -> Vec<String> {
        let widths = self.widths();
        let line = |row: &Vec<String>| {
            let cells: Vec<String> = widths
                .iter()
                .enumerate()
                .map(|(c, &width)| {
                    let cell = row.get(c).map_or("", String::as_str);
                    if c == 0 { format!("{cell:<width$}") } else { format!("{cell:>width$}") }
                })
                .collect();
            cells.join(between)
        };
        self.rows.iter().map(line).collect()
    }

    /// Columns as wide as their widest cell.
    pub(crate) fn text(&self) -> String {
        self.lines("  ").iter().map(|line| format!("{}\n", line.trim_end())).collect()
    }

    /// A Markdown table.
    pub(crate) fn markdown(&self) -> String {
        let mut lines: Vec<String> = self.lines(" | ").iter().map(|line| format!("| {line} |\n")).collect();
        let rule = self.widths().into_iter().enumerate().map(|(c, w)| {
            if c == 0 { format!("{}|", "-".repeat(w + 2)) } else { format!("{}:|", "-".repeat(w + 1)) }
        });
        let rule: String = rule.collect();
        lines.insert(1.min(lines.len()), format!("|{rule}\n"));
        lines.concat()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_and_markdown_hold_every_cell() {
        let mut table = Table::new(["hand", "µ"]);
        table.row(["leap", "25/100.0%"]);
        assert_eq!(table.text(), "hand          µ\nleap  25/100.0%\n");
        assert_eq!(table.markdown(), "| hand |         µ |\n|------|----------:|\n| leap | 25/100.0% |\n");
    }
}
