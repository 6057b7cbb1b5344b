//! Tensors as bytes, in native byte order and row-major.
use crate::{Failure, Kind};
use bytemuck::{try_cast_slice, AnyBitPattern, NoUninit};
use half::{bf16, f16};
use ort::session::SessionInputValue;
use ort::value::{DynValue, Tensor as OrtTensor, TensorElementType, TensorRef};

/// The supported element types, with the names that Elixir uses.
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
    /// 1 byte. In inputs, 0 is false and all other values are true. In outputs, 1 is true.
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
    /// Returns the type with this name (`f32`, `s64`, `bool` ...), or `None`.
    #[must_use]
    pub fn parse(name: &str) -> Option<Self> {
        NAMES.iter().find(|row| row.1 == name).map(|row| row.0)
    }

    /// Returns the name that `parse` accepts.
    #[must_use]
    pub fn name(self) -> &'static str {
        NAMES
            .iter()
            .find(|row| row.0 == self)
            .map_or("f32", |row| row.1)
    }

    /// Returns the bytes of an element, 1 to 8.
    #[must_use]
    pub fn byte_size(self) -> usize {
        NAMES
            .iter()
            .find(|row| row.0 == self)
            .map_or(4, |row| row.3)
    }

    pub(crate) fn from_ort(ty: TensorElementType) -> Option<Self> {
        NAMES.iter().find(|row| row.2 == ty).map(|row| row.0)
    }
}

/// An input, borrowed from the caller.
#[derive(Debug, Clone)]
pub struct TensorView<'a> {
    /// The name of the input, as in `Model::inputs`.
    pub name: String,
    /// The type of every element, which must be that of the port.
    pub ty: ElementType,
    /// The sizes, outermost dimension first, none of them negative; empty for a scalar.
    pub shape: Vec<i64>,
    /// The elements, row-major, in native byte order. Their size must be exactly the product of `shape` times
    /// `ty.byte_size()` bytes, otherwise the run returns `Kind::Input`. Alignment is not required, but unaligned
    /// memory is copied.
    pub data: &'a [u8],
}

/// An output.
#[derive(Debug, Clone, PartialEq)]
pub struct Tensor {
    /// The name of the output, as in `Model::outputs`.
    pub name: String,
    /// The type of every element.
    pub ty: ElementType,
    /// The sizes, outermost dimension first. Free dimensions of the port have their actual size.
    pub shape: Vec<i64>,
    /// The elements, row-major, in native byte order.
    pub data: Vec<u8>,
}

impl<'a> TensorView<'a> {
    /// Returns an ONNX Runtime value that refers to the caller's bytes. They are copied only if they are not aligned
    /// for the type.
    pub(crate) fn to_value(&self) -> Result<SessionInputValue<'a>, Failure> {
        self.check_size()?;
        match self.ty {
            ElementType::F16 => typed_value::<f16>(self),
            ElementType::Bf16 => typed_value::<bf16>(self),
            ElementType::F32 => typed_value::<f32>(self),
            ElementType::F64 => typed_value::<f64>(self),
            ElementType::S8 => typed_value::<i8>(self),
            ElementType::S16 => typed_value::<i16>(self),
            ElementType::S32 => typed_value::<i32>(self),
            ElementType::S64 => typed_value::<i64>(self),
            ElementType::U8 => typed_value::<u8>(self),
            ElementType::U16 => typed_value::<u16>(self),
            ElementType::U32 => typed_value::<u32>(self),
            ElementType::U64 => typed_value::<u64>(self),
            ElementType::Bool => {
                let flags: Vec<bool> = self.data.iter().map(|b| *b != 0).collect();
                let tensor =
                    OrtTensor::from_array((self.shape.clone(), flags)).map_err(input_error)?;
                Ok(tensor.into())
            }
        }
    }

    fn check_size(&self) -> Result<(), Failure> {
        let wanted = self.shape.iter().try_fold(self.ty.byte_size(), |n, d| {
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

fn input_error(error: ort::Error) -> Failure {
    Failure::new(Kind::Input, error.to_string())
}

fn typed_value<'a, T>(tensor: &TensorView<'a>) -> Result<SessionInputValue<'a>, Failure>
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
            .map_err(input_error)?
            .into()),
        Err(_) => {
            let mut owned = vec![T::zeroed(); tensor.data.len() / std::mem::size_of::<T>()];
            bytemuck::cast_slice_mut::<T, u8>(&mut owned).copy_from_slice(tensor.data);
            Ok(OrtTensor::from_array((tensor.shape.clone(), owned))
                .map_err(input_error)?
                .into())
        }
    }
}

pub(crate) fn from_value(name: &str, value: &DynValue) -> Result<Tensor, Failure> {
    let ort::value::ValueType::Tensor { ty, .. } = value.dtype() else {
        return Err(Failure::new(
            Kind::Run,
            format!("output {name:?} is not a tensor"),
        ));
    };
    let ty = ElementType::from_ort(*ty).ok_or_else(|| {
        Failure::new(
            Kind::Run,
            format!("output {name:?} has type {ty}, which is not supported"),
        )
    })?;
    let (shape, data) = match ty {
        ElementType::F16 => extract_bytes::<f16>(value),
        ElementType::Bf16 => extract_bytes::<bf16>(value),
        ElementType::F32 => extract_bytes::<f32>(value),
        ElementType::F64 => extract_bytes::<f64>(value),
        ElementType::S8 => extract_bytes::<i8>(value),
        ElementType::S16 => extract_bytes::<i16>(value),
        ElementType::S32 => extract_bytes::<i32>(value),
        ElementType::S64 => extract_bytes::<i64>(value),
        ElementType::U8 => extract_bytes::<u8>(value),
        ElementType::U16 => extract_bytes::<u16>(value),
        ElementType::U32 => extract_bytes::<u32>(value),
        ElementType::U64 => extract_bytes::<u64>(value),
        ElementType::Bool => extract_bytes::<bool>(value),
    }?;
    Ok(Tensor {
        name: name.to_owned(),
        ty,
        shape,
        data,
    })
}

fn extract_bytes<T>(value: &DynValue) -> Result<(Vec<i64>, Vec<u8>), Failure>
where
    T: ort::value::PrimitiveTensorElementType + NoUninit,
{
    let (shape, data) = value
        .try_extract_tensor::<T>()
        .map_err(|e| Failure::new(Kind::Run, e.to_string()))?;
    Ok((shape.to_vec(), bytemuck::cast_slice::<T, u8>(data).to_vec()))
}
