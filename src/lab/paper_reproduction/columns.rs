//! The raw rows as Parquet: the CSV's columns, each whole numbers, numbers or text by what stands in it.

use std::fs::File;
use std::path::Path;
use std::sync::Arc;

use parquet::basic::{ConvertedType, Repetition, Type as Physical};
use parquet::data_type::{ByteArray, ByteArrayType, DoubleType, Int64Type};
use parquet::errors::ParquetError;
use parquet::file::properties::WriterProperties;
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::types::Type;

use super::csv::fields;

/// A column's values; what is empty in the CSV is absent.
enum Column {
    Whole(Vec<Option<i64>>),
    Real(Vec<Option<f64>>),
    Text(Vec<Option<ByteArray>>),
}

impl Column {
    fn of(cells: &[String]) -> Self {
        fn all<T>(cells: &[String], parse: impl Fn(&str) -> Option<T>) -> Option<Vec<Option<T>>> {
            let value = |cell: &String| if cell.is_empty() { Some(None) } else { parse(cell).map(Some) };
            cells.iter().map(value).collect()
        }
        if let Some(whole) = all(cells, |cell| cell.parse().ok()) {
            Self::Whole(whole)
        } else if let Some(real) = all(cells, |cell| cell.parse().ok()) {
            Self::Real(real)
        } else {
            let text = |cell: &String| (!cell.is_empty()).then(|| ByteArray::from(cell.as_str()));
            Self::Text(cells.iter().map(text).collect())
        }
    }

    fn schema(&self, name: &str) -> Result<Arc<Type>, ParquetError> {
        let (physical, converted) = match self {
            Self::Whole(_) => (Physical::INT64, ConvertedType::NONE),
            Self::Real(_) => (Physical::DOUBLE, ConvertedType::NONE),
            Self::Text(_) => (Physical::BYTE_ARRAY, ConvertedType::UTF8),
        };
        let field = Type::primitive_type_builder(name, physical).with_converted_type(converted);
        Ok(Arc::new(field.with_repetition(Repetition::OPTIONAL).build()?))
    }
}

/// The values that are there, and for each place whether one is.
fn present<T: Clone>(values: &[Option<T>]) -> (Vec<T>, Vec<i16>) {
    (
        values.iter().flatten().cloned().collect(),
        values.iter().map(|value| i16::from(value.is_some())).collect(),
    )
}

/// Writes a CSV's rows as one Parquet file.
///
/// # Errors
/// If the file cannot be written.
pub fn write(path: &Path, csv: &str) -> Result<(), ParquetError> {
    let mut lines = csv.lines();
    let names = lines.next().map(fields).unwrap_or_default();
    let rows: Vec<Vec<String>> = lines.map(fields).collect();
    let columns: Vec<Column> = (0..names.len())
        .map(|at| rows.iter().map(|row| row.get(at).cloned().unwrap_or_default()).collect::<Vec<_>>())
        .map(|cells| Column::of(&cells))
        .collect();
    let types = names.iter().zip(&columns).map(|(name, column)| column.schema(name));
    let schema = Type::group_type_builder("rows").with_fields(types.collect::<Result<_, _>>()?).build()?;
    let properties = Arc::new(WriterProperties::builder().build());
    let mut file = SerializedFileWriter::new(File::create(path)?, Arc::new(schema), properties)?;
    let mut group = file.next_row_group()?;
    for column in &columns {
        let Some(mut writer) = group.next_column()? else { break };
        match column {
            Column::Whole(values) => {
                let (values, there) = present(values);
                writer.typed::<Int64Type>().write_batch(&values, Some(&there), None)?;
            }
            Column::Real(values) => {
                let (values, there) = present(values);
                writer.typed::<DoubleType>().write_batch(&values, Some(&there), None)?;
            }
            Column::Text(values) => {
                let (values, there) = present(values);
                writer.typed::<ByteArrayType>().write_batch(&values, Some(&there), None)?;
            }
        }
        writer.close()?;
    }
    group.close()?;
    file.close()?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use parquet::file::reader::{FileReader, SerializedFileReader};

    #[test]
    fn rows_round_trip_with_their_types() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("rows.parquet");
        write(&path, "seed,share,name,none\n40,0.5,\"a, b\",\n41,,c,\n42,2,d,\n").unwrap();
        let reader = SerializedFileReader::new(File::open(&path).unwrap()).unwrap();
        let rows: Vec<String> =
            reader.get_row_iter(None).unwrap().map(|row| row.unwrap().to_string()).collect();
        let wanted = [
            r#"{seed: 40, share: 0.5, name: "a, b", none: null}"#,
            r#"{seed: 41, share: null, name: "c", none: null}"#,
            r#"{seed: 42, share: 2.0, name: "d", none: null}"#,
        ];
        assert_eq!(rows, wanted);
    }
}
