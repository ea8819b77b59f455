//! What is looked at before a component is compiled: a compiler is not asked to do what has no end in sight.

use wasmparser::{
    BlockType, CanonicalFunction, ComponentType, CompositeInnerType, FunctionBody, Operator, Parser, Payload,
};

use crate::error::{ComponentError, line};

/// The most functions of all its modules.
const FUNCTIONS_MAX: usize = 10_000;

/// The most bytes of one function.
const BODY_BYTES_MAX: usize = 256 << 10;

/// The most local variables of one function.
const LOCALS_MAX: usize = 2_000;

/// The most modules and components within it.
const NESTED_MAX: usize = 64;

/// The most parameters of a function or block, and the most results.
const VALUES_MAX: usize = 64;

/// How deep blocks may lie within each other.
const DEPTH_MAX: usize = 1_000;

/// The most that blocks of one function hand over, and local variables that its loops may change: what a compiler spends its memory
/// on, by more than in proportion. A loop counts as many as its function has local variables; the kit's largest function has 1,728.
const CARRIED_IN_ONE_MAX: usize = 20_000;

/// The same of all functions together.
const CARRIED_MAX: usize = 200_000;

/// Refuses what is more than a skill's code has; resources of its own, whose handles are memory that nothing counts; and components
/// within it that have functions of their own, whose calls to each other would be code that the compiler makes up.
///
/// # Errors
/// If it is no WebAssembly as far as this looks, or has more of something than is allowed.
pub(crate) fn scan(bytes: &[u8]) -> Result<(), ComponentError> {
    let (mut functions, mut nested, mut carried) = (0, 0, 0);
    // Where in the nesting this is, and the types of each module that is open.
    let mut types: Vec<Vec<BlockArity>> = Vec::new();
    for payload in Parser::new(0).parse_all(bytes) {
        match payload.map_err(|error| invalid(&error))? {
            Payload::Version { .. } => types.push(Vec::new()),
            Payload::End(_) => {
                types.pop();
            }
            Payload::ModuleSection { .. } | Payload::ComponentSection { .. } => {
                nested += 1;
                within("modules and components within it", nested, NESTED_MAX)?;
            }
            Payload::ComponentCanonicalSection(functions) => {
                for function in functions {
                    let function = function.map_err(|error| invalid(&error))?;
                    if types.len() > 1 && matches!(function, CanonicalFunction::Lift { .. }) {
                        return Err(ComponentError::Composed);
                    }
                }
            }
            Payload::ComponentTypeSection(types) => {
                for ty in types {
                    if let ComponentType::Resource { .. } = ty.map_err(|error| invalid(&error))? {
                        return Err(ComponentError::Resource);
                    }
                }
            }
            Payload::TypeSection(groups) => {
                for group in groups {
                    for ty in group.map_err(|error| invalid(&error))?.types() {
                        let values = values(&ty.composite_type.inner);
                        within("parameters of a function or block", values.taken, VALUES_MAX)?;
                        within("results of a function or block", values.given, VALUES_MAX)?;
                        if let Some(module) = types.last_mut() {
                            module.push(values);
                        }
                    }
                }
            }
            Payload::CodeSectionEntry(body) => {
                functions += 1;
                within("functions", functions, FUNCTIONS_MAX)?;
                within("bytes in one function", body.range().len(), BODY_BYTES_MAX)?;
                let locals = locals(&body)?;
                within("local variables in one function", locals, LOCALS_MAX)?;
                let known = types.last().map_or(&[][..], Vec::as_slice);
                let in_one = blocks(&body, known, locals)?;
                carried += in_one;
                within(
                    "values that blocks of a function hand over or its loops may change",
                    in_one,
                    CARRIED_IN_ONE_MAX,
                )?;
                within("values that blocks hand over or loops may change", carried, CARRIED_MAX)?;
            }
            _ => {}
        }
    }
    Ok(())
}

/// How many values a function or block takes and gives.
#[derive(Clone, Copy, Default)]
struct BlockArity {
    taken: usize,
    given: usize,
}

fn values(ty: &CompositeInnerType) -> BlockArity {
    match ty {
        CompositeInnerType::Func(ty) => BlockArity { taken: ty.params().len(), given: ty.results().len() },
        _ => BlockArity::default(),
    }
}

/// What the blocks of a function hand over, and its loops may change.
fn blocks(body: &FunctionBody, types: &[BlockArity], locals: usize) -> Result<usize, ComponentError> {
    let (mut depth, mut carried) = (0_usize, 0_usize);
    let operators = body.get_operators_reader().map_err(|error| invalid(&error))?;
    for operator in operators {
        let (ty, changes) = match operator.map_err(|error| invalid(&error))? {
            Operator::Block { blockty } | Operator::If { blockty } => (blockty, 0),
            Operator::Loop { blockty } => (blockty, locals),
            Operator::End => {
                depth = depth.saturating_sub(1);
                continue;
            }
            _ => continue,
        };
        depth += 1;
        within("blocks within each other", depth, DEPTH_MAX)?;
        let values = match ty {
            BlockType::Empty => BlockArity::default(),
            BlockType::Type(_) => BlockArity { taken: 0, given: 1 },
            BlockType::FuncType(index) => {
                let index = usize::try_from(index).unwrap_or(usize::MAX);
                types.get(index).copied().unwrap_or_default()
            }
        };
        carried += values.taken + values.given + changes;
    }
    Ok(carried)
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

#[cfg(test)]
mod tests {
    use super::*;

    fn scanned(module: &str) -> Result<(), ComponentError> {
        scan(&wat::parse_str(format!("(component {module})")).unwrap())
    }

    fn of_function(body: &str) -> Result<(), ComponentError> {
        scanned(&format!("(core module {body})"))
    }

    fn nested(depth: usize, begins: &str) -> String {
        format!("{}{}", begins.repeat(depth), ")".repeat(depth))
    }

    #[test]
    fn sizes_that_cost_the_compiler_memory_are_limited() {
        let many = |keyword: &str, count: usize| format!("({keyword}{})", " i64".repeat(count));
        let carried = |values: usize, depth: usize| {
            let ty = format!("(type $t (func {} {}))", many("param", values), many("result", values));
            let consts = "(i64.const 0)".repeat(values);
            let begins = "(loop (type $t) ".repeat(depth);
            format!("{ty}(func (result{}) {consts} {begins}{})", " i64".repeat(values), ")".repeat(depth))
        };
        of_function(&carried(64, 150)).unwrap();
        for (module, found, allowed) in [
            (carried(65, 1), 65, VALUES_MAX),
            (carried(64, 1_000), 128_000, CARRIED_IN_ONE_MAX),
            (format!("(func {})", nested(1_001, "(block ")), 1_001, DEPTH_MAX),
            (
                format!("(func (local{}) {})", " i64".repeat(2_000), nested(201, "(loop ")),
                402_000,
                CARRIED_IN_ONE_MAX,
            ),
            (
                format!("(func (local{}) {})", " i64".repeat(1_000), nested(20, "(loop ")).repeat(11),
                220_000,
                CARRIED_MAX,
            ),
            (format!("(func (local{}))", " i64".repeat(2_001)), 2_001, LOCALS_MAX),
        ] {
            let error = of_function(&module).unwrap_err();
            let ComponentError::TooMuch { count, max, .. } = error else { panic!("{error}") };
            assert_eq!((count, max), (found, allowed));
        }
    }

    #[test]
    fn components_that_call_each_other_are_refused() {
        let inner = "(component $inner
            (core module $m (func (export \"f\")))
            (core instance $i (instantiate $m))
            (func (export \"f\") (canon lift (core func $i \"f\"))))";
        let bytes = wat::parse_str(format!("(component {inner})")).unwrap();
        assert!(matches!(scan(&bytes), Err(ComponentError::Composed)));
        scanned(
            "(core module $m (func (export \"f\"))) (core instance $i (instantiate $m))
            (func (export \"f\") (canon lift (core func $i \"f\")))",
        )
        .unwrap();
    }
}
