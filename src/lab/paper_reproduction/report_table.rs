//! A table of the report, in Markdown and in HTML.

use holdpoint_plot::escaped;

/// The cells of a line.
fn cells(line: &str) -> impl Iterator<Item = &str> {
    line.split('|').map(str::trim)
}

/// See the module's head.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ReportTable {
    pub title: String,
    pub columns: Vec<String>,
    pub rows: Vec<Vec<String>>,
    /// Notes for reading it.
    pub note: String,
    /// Of how many seeds its rows are, and how many its preset has; absent where it rests on none.
    pub seeds: Option<(usize, u64)>,
}

impl ReportTable {
    /// A table without rows: its title, its columns separated by `|`, and its note.
    #[must_use]
    pub fn new([title, columns, note]: [&str; 3]) -> Self {
        Self {
            title: title.to_owned(),
            columns: cells(columns).map(str::to_owned).collect(),
            note: note.to_owned(),
            ..Self::default()
        }
    }

    /// A table of fixed texts; the cells of a row are separated by `|`.
    #[must_use]
    pub fn fixed(head: [&str; 3], rows: &[&str]) -> Self {
        let mut table = Self::new(head);
        for row in rows {
            table.row(cells(row));
        }
        table
    }

    /// Its heading: the title, and the finished part of the plan.
    fn heading(&self) -> String {
        self.seeds.map_or_else(
            || self.title.clone(),
            |(seeds, of)| format!("{} ({seeds} of {of} seeds)", self.title),
        )
    }

    pub fn row<T: Into<String>>(&mut self, cells: impl IntoIterator<Item = T>) {
        self.rows.push(cells.into_iter().map(Into::into).collect());
    }

    /// With a heading, and the note below.
    #[must_use]
    pub fn markdown(&self) -> String {
        let line = |cells: &[String]| {
            let cells: Vec<String> = cells.iter().map(|cell| cell.replace('|', "\\|")).collect();
            format!("| {} |\n", cells.join(" | "))
        };
        let mut text = format!("### {}\n\n{}", self.heading(), line(&self.columns));
        text.push_str(&format!("|{}\n", " --- |".repeat(self.columns.len())));
        for row in &self.rows {
            text.push_str(&line(row));
        }
        if !self.note.is_empty() {
            text.push_str(&format!("\n{}\n", self.note));
        }
        text.push('\n');
        text
    }

    /// As Markdown, for a page whose script sorts by a click on a column.
    #[must_use]
    pub fn html(&self) -> String {
        let cells = |tag: &str, cells: &[String]| -> String {
            cells.iter().map(|cell| ["<", tag, ">", &escaped(cell), "</", tag, ">"].concat()).collect()
        };
        let mut text = format!("<h3>{}</h3>\n<table>\n<thead><tr>", escaped(&self.heading()));
        text.push_str(&cells("th", &self.columns));
        text.push_str("</tr></thead>\n<tbody>\n");
        for row in &self.rows {
            text.push_str(&format!("<tr>{}</tr>\n", cells("td", row)));
        }
        text.push_str("</tbody>\n</table>\n");
        if !self.note.is_empty() {
            text.push_str(&format!("<p class=\"note\">{}</p>\n", escaped(&self.note)));
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn table_cells_are_escaped() {
        let mut table = ReportTable::new(["a < b", "what | n", "see \"x\" & y"]);
        table.row(["a|b", "<script>"]);
        assert_eq!(table.markdown().lines().filter(|line| line.starts_with('|')).count(), 3);
        assert!(table.markdown().contains("a\\|b"));
        let html = table.html();
        assert!(html.contains("&lt;script&gt;") && !html.contains("<script>"), "{html}");
        assert!(html.contains("&quot;x&quot; &amp; y"), "{html}");
    }

    #[test]
    fn a_table_shows_its_number_of_seeds() {
        let mut table = ReportTable::new(["arms", "arm", ""]);
        assert!(table.markdown().starts_with("### arms\n") && table.html().starts_with("<h3>arms</h3>"));
        table.seeds = Some((15, 40));
        assert!(table.markdown().starts_with("### arms (15 of 40 seeds)\n"));
        assert!(table.html().starts_with("<h3>arms (15 of 40 seeds)</h3>"));
    }
}
