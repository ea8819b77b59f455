//! What is looked at before a component is compiled: a compiler is not asked to do what has no end in sight.

use wasmparser::{ComponentType, FunctionBody, Parser, Payload};

use crate::error::{ComponentError, line};

/// The most functions of all its modules.
const FUNCTIONS_MAX: usize = 20_000;

/// The most bytes of one function.
const BODY_BYTES_MAX: usize = 256 << 10;

/// The most local variables of one function.
const LOCALS_MAX: usize = 5_000;

/// The most modules and components within it.
const NESTED_MAX: usize = 64;

/// Refuses what is more than a skill's code has, and resources of its own: their handles are memory that nothing counts.
///
/// # Errors
/// If it is no WebAssembly as far as this looks, or has more of something than is allowed.
pub(crate) fn scan(bytes: &[u8]) -> Result<(), ComponentError> {
    let (mut functions, mut nested) = (0, 0);
    for payload in Parser::new(0).parse_all(bytes) {
        match payload.map_err(|error| invalid(&error))? {
            Payload::ModuleSection { .. } | Payload::ComponentSection { .. } => {
                nested += 1;
                within("modules and components within it", nested, NESTED_MAX)?;
            }
            Payload::ComponentTypeSection(types) => {
                for ty in types {
                    if let ComponentType::Resource { .. } = ty.map_err(|error| invalid(&error))? {
                        return Err(ComponentError::Resource);
                    }
                }
            }
            Payload::CodeSectionEntry(body) => {
                functions += 1;
                within("functions", functions, FUNCTIONS_MAX)?;
                within("bytes in one function", body.range().len(), BODY_BYTES_MAX)?;
                within("local variables in one function", locals(&body)?, LOCALS_MAX)?;
            }
            _ => {}
        }
    }
    Ok(())
}

fn locals(body: &FunctionBody) -> Result<usize, ComponentError> {
    let reader = body.get_locals_reader().map_err(|error| invalid(&error))?;
    reader.into_iter().try_fold(0_usize, |sum, group| {
        let (count, _) = group.map_err(|error| invalid(&error))?;
        Ok(sum.saturating_add(usize::try_from(count).unwrap_or(usize::MAX)))
    })
}

fn within(what: &'static str, count: usize, max: usize) -> Result<(), ComponentError> {
    if count > max { Err(ComponentError::TooMuch { what, count, max }) } else { Ok(()) }
}

fn invalid(error: &wasmparser::BinaryReaderError) -> ComponentError {
    ComponentError::Invalid { reason: line(error.to_string()) }
}
