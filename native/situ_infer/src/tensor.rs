//! Tensors as bytes: native byte order, row major.
use crate::{Failure, Kind};
use bytemuck::{try_cast_slice, AnyBitPattern, NoUninit};
use half::{bf16, f16};
use ort::session::SessionInputValue;
use ort::value::{DynValue, Tensor as OrtTensor, TensorElementType, TensorRef};

/// The element types that cross the border, with the names Elixir knows them by.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ElementType {
    /// IEEE 754 binary16.
    F16,
    /// The upper half of a binary32.
    Bf16,
    /// IEEE 754 binary32.
    F32,
    /// IEEE 754 binary64.
    F64,
    /// Two's complement, 1 byte.
    S8,
    /// Two's complement, 2 bytes.
    S16,
    /// Two's complement, 4 bytes.
    S32,
    /// Two's complement, 8 bytes.
    S64,
    /// Unsigned, 1 byte.
    U8,
    /// Unsigned, 2 bytes.
    U16,
    /// Unsigned, 4 bytes.
    U32,
    /// Unsigned, 8 bytes.
    U64,
    /// 1 byte: 0 is false; on the way in any other value is true, on the way out only 1 is.
    Bool,
}

const NAMES: [(ElementType, &str, TensorElementType, usize); 13] = [
    (ElementType::F16, "f16", TensorElementType::Float16, 2),
    (ElementType::Bf16, "bf16", TensorElementType::Bfloat16, 2),
    (ElementType::F32, "f32", TensorElementType::Float32, 4),
    (ElementType::F64, "f64", TensorElementType::Float64, 8),
    (ElementType::S8, "s8", TensorElementType::Int8, 1),
    (ElementType::S16, "s16", TensorElementType::Int16, 2),
    (ElementType::S32, "s32", TensorElementType::Int32, 4),
    (ElementType::S64, "s64", TensorElementType::Int64, 8),
    (ElementType::U8, "u8", TensorElementType::Uint8, 1),
    (ElementType::U16, "u16", TensorElementType::Uint16, 2),
    (ElementType::U32, "u32", TensorElementType::Uint32, 4),
    (ElementType::U64, "u64", TensorElementType::Uint64, 8),
    (ElementType::Bool, "bool", TensorElementType::Bool, 1),
];

impl ElementType {
    /// The type of this name (`f32`, `s64`, `bool` ...); `None` for any other text.
    #[must_use]
    pub fn parse(name: &str) -> Option<Self> {
        NAMES.iter().find(|row| row.1 == name).map(|row| row.0)
    }

    /// The name that `parse` takes.
    #[must_use]
    pub fn name(self) -> &'static str {
        NAMES
            .iter()
            .find(|row| row.0 == self)
            .map_or("f32", |row| row.1)
    }

    /// Bytes of one element, 1 to 8.
    #[must_use]
    pub fn size(self) -> usize {
        NAMES
            .iter()
            .find(|row| row.0 == self)
            .map_or(4, |row| row.3)
    }

    pub(crate) fn from_ort(ty: TensorElementType) -> Option<Self> {
        NAMES.iter().find(|row| row.2 == ty).map(|row| row.0)
    }
}

/// One input, borrowed from the caller.
#[derive(Debug, Clone)]
pub struct TensorView<'a> {
    /// The input's name, as `Model::inputs` has it.
    pub name: String,
    /// The type of every element; it must be the port's.
    pub ty: ElementType,
    /// Sizes, the outermost dimension first, none of them negative; empty for a single number.
    pub shape: Vec<i64>,
    /// The elements, row major, native byte order: exactly the product of `shape` times `ty.size()` bytes, else the run
    /// answers `Kind::Input`. Alignment is not needed; memory that has it is not copied.
    pub data: &'a [u8],
}

/// One output.
#[derive(Debug, Clone, PartialEq)]
pub struct Tensor {
    /// The output's name, as `Model::outputs` has it.
    pub name: String,
    /// The type of every element.
    pub ty: ElementType,
    /// Sizes, the outermost dimension first; free dimensions of the port have got their size.
    pub shape: Vec<i64>,
    /// The elements, row major, native byte order.
    pub data: Vec<u8>,
}

impl<'a> TensorView<'a> {
    /// An ONNX Runtime value over the caller's bytes; copies only when they are not aligned for the type.
    pub(crate) fn to_value(&self) -> Result<SessionInputValue<'a>, Failure> {
        self.check()?;
        match self.ty {
            ElementType::F16 => view::<f16>(self),
            ElementType::Bf16 => view::<bf16>(self),
            ElementType::F32 => view::<f32>(self),
            ElementType::F64 => view::<f64>(self),
            ElementType::S8 => view::<i8>(self),
            ElementType::S16 => view::<i16>(self),
            ElementType::S32 => view::<i32>(self),
            ElementType::S64 => view::<i64>(self),
            ElementType::U8 => view::<u8>(self),
            ElementType::U16 => view::<u16>(self),
            ElementType::U32 => view::<u32>(self),
            ElementType::U64 => view::<u64>(self),
            ElementType::Bool => {
                let flags: Vec<bool> = self.data.iter().map(|b| *b != 0).collect();
                let tensor = OrtTensor::from_array((self.shape.clone(), flags)).map_err(bad)?;
                Ok(tensor.into())
            }
        }
    }

    fn check(&self) -> Result<(), Failure> {
        let wanted = self.shape.iter().try_fold(self.ty.size(), |n, d| {
            usize::try_from(*d).ok().and_then(|d| n.checked_mul(d))
        });
        if wanted == Some(self.data.len()) {
            return Ok(());
        }
        let text = format!(
            "input {:?}: {} bytes do not fill {:?} of {}",
            self.name,
            self.data.len(),
            self.shape,
            self.ty.name()
        );
        Err(Failure::new(Kind::Input, text))
    }
}

fn bad(error: ort::Error) -> Failure {
    Failure::new(Kind::Input, error.to_string())
}

fn view<'a, T>(tensor: &TensorView<'a>) -> Result<SessionInputValue<'a>, Failure>
where
    T: ort::value::PrimitiveTensorElementType
        + AnyBitPattern
        + NoUninit
        + Clone
        + std::fmt::Debug
        + 'static,
{
    match try_cast_slice::<u8, T>(tensor.data) {
        Ok(slice) => Ok(TensorRef::from_array_view((tensor.shape.clone(), slice))
            .map_err(bad)?
            .into()),
        Err(_) => {
            let mut owned = vec![T::zeroed(); tensor.data.len() / std::mem::size_of::<T>()];
            bytemuck::cast_slice_mut::<T, u8>(&mut owned).copy_from_slice(tensor.data);
            Ok(OrtTensor::from_array((tensor.shape.clone(), owned))
                .map_err(bad)?
                .into())
        }
    }
}

pub(crate) fn from_value(name: &str, value: &DynValue) -> Result<Tensor, Failure> {
    let ort::value::ValueType::Tensor { ty, .. } = value.dtype() else {
        return Err(Failure::new(
            Kind::Run,
            format!("output {name:?} is no tensor"),
        ));
    };
    let ty = ElementType::from_ort(*ty).ok_or_else(|| {
        Failure::new(
            Kind::Run,
            format!("output {name:?} has type {ty}, which is not supported"),
        )
    })?;
    let (shape, data) = match ty {
        ElementType::F16 => bytes::<f16>(value),
        ElementType::Bf16 => bytes::<bf16>(value),
        ElementType::F32 => bytes::<f32>(value),
        ElementType::F64 => bytes::<f64>(value),
        ElementType::S8 => bytes::<i8>(value),
        ElementType::S16 => bytes::<i16>(value),
        ElementType::S32 => bytes::<i32>(value),
        ElementType::S64 => bytes::<i64>(value),
        ElementType::U8 => bytes::<u8>(value),
        ElementType::U16 => bytes::<u16>(value),
        ElementType::U32 => bytes::<u32>(value),
        ElementType::U64 => bytes::<u64>(value),
        ElementType::Bool => bytes::<bool>(value),
    }?;
    Ok(Tensor {
        name: name.to_owned(),
        ty,
        shape,
        data,
    })
}

fn bytes<T>(value: &DynValue) -> Result<(Vec<i64>, Vec<u8>), Failure>
where
    T: ort::value::PrimitiveTensorElementType + NoUninit,
{
    let (shape, data) = value
        .try_extract_tensor::<T>()
        .map_err(|e| Failure::new(Kind::Run, e.to_string()))?;
    Ok((shape.to_vec(), bytemuck::cast_slice::<T, u8>(data).to_vec()))
}
