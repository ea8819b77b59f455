//! All themes: the built-in ones, and the operator's own, which come first by name.

use super::{Theme, ThemeError, names};

/// The most own themes of an operator.
pub const OWN_MAX: usize = 32;

#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Themes {
    own: Vec<Theme>,
}

impl Themes {
    /// The built-in themes and those of these files: name (with or without folder) and text.
    ///
    /// # Errors
    /// The first problem of a file, with line, key and the allowed values; more than [`OWN_MAX`] files.
    pub fn with_files(files: &[(String, String)]) -> Result<Self, ThemeError> {
        if let Some((name, _)) = files.get(OWN_MAX) {
            return Err(ThemeError::TooMany { name: name.clone(), allowed: OWN_MAX });
        }
        let own = files.iter().map(|(name, text)| Theme::with_file(name, text)).collect::<Result<_, _>>()?;
        Ok(Self { own })
    }

    /// Names, the built-in default first.
    #[must_use]
    pub fn names(&self) -> Vec<String> {
        let own = self.own.iter().map(|theme| theme.name().to_owned());
        let builtin = names().into_iter().map(ToOwned::to_owned);
        let mut all: Vec<String> = builtin.collect();
        all.extend(own.filter(|name| !names().contains(&name.as_str())));
        all
    }

    /// A theme by its name.
    ///
    /// # Errors
    /// [`ThemeError::Unknown`] with the existing names.
    pub fn get(&self, name: &str) -> Result<Theme, ThemeError> {
        if let Some(own) = self.own.iter().find(|theme| theme.name() == name) {
            return Ok(own.clone());
        }
        Theme::builtin(name).map_err(|error| match error {
            ThemeError::Unknown { name, .. } => {
                ThemeError::Unknown { name, allowed: self.names().join(", ") }
            }
            other => other,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn own_themes_extend_and_replace_the_built_in_ones() {
        let text = "inherits = \"mono\"\n[roles]\ntitle = { bold = true }\n";
        let files = [("dusk.toml".to_owned(), text.to_owned()), ("mono.toml".to_owned(), text.to_owned())];
        let themes = Themes::with_files(&files).unwrap();
        assert_eq!(themes.get("dusk").unwrap().name(), "dusk");
        assert_eq!(themes.names().iter().filter(|name| *name == "mono").count(), 1);
        assert!(themes.get("calm-dark").is_ok());
        let error = themes.get("dawn").unwrap_err().to_string();
        assert!(error.contains("dawn") && error.contains("dusk"), "{error}");
        let many = vec![("x.toml".to_owned(), text.to_owned()); OWN_MAX + 1];
        assert!(Themes::with_files(&many).unwrap_err().to_string().contains("32"));
    }
}
