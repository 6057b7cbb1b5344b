defmodule Situ.Number do
  @moduledoc false
  # Arithmetic on numbers that may be `:nan`, `:infinity` or `:neg_infinity`, following IEEE 754.
  #
  # Erlang floats cannot hold these values. Wherever Situ computes with numbers, these atoms
  # represent them, as in Nx. `:nan` propagates. Integers stay exact.

  # See docs/adr/0022-nan-and-infinity-are-atoms.md.
  import Situ.BinarySize, only: [pinned_size: 1]

  @type t :: number() | :nan | :infinity | :neg_infinity

  @doc "Returns whether `value` is a number, `:nan`, `:infinity` or `:neg_infinity`."
  @spec number?(term()) :: boolean()
  def number?(value), do: is_number(value) or value in [:nan, :infinity, :neg_infinity]

  @doc """
  Adds two numbers; a sum that is too large for a float is infinite.

      iex> Situ.Number.add(:infinity, 1)
      :infinity
      iex> Situ.Number.add(:infinity, :neg_infinity)
      :nan
      iex> Situ.Number.min(3, :nan)
      :nan
  """
  @spec add(t(), t()) :: t()
  def add(a, b) when is_integer(a) and is_integer(b), do: a + b
  def add(a, b) when is_number(a) and is_number(b), do: add_floats(a, b)
  def add(:nan, b), do: nan_if_number(b)
  def add(a, :nan), do: nan_if_number(a)
  def add(:infinity, :neg_infinity), do: :nan
  def add(:neg_infinity, :infinity), do: :nan
  def add(a, b) when is_number(b), do: check_infinite(a)
  def add(a, b) when is_number(a), do: check_infinite(b)
  def add(a, a), do: check_infinite(a)

  @doc "Subtracts `b` from `a`."
  @spec subtract(t(), t()) :: t()
  def subtract(a, b) when is_integer(a) and is_integer(b), do: a - b
  def subtract(a, b) when is_float(a) and is_float(b), do: add_floats(a, -b)
  def subtract(a, b), do: add(a, negate(b))

  @doc "Multiplies two numbers."
  @spec multiply(t(), t()) :: t()
  def multiply(a, b) when is_integer(a) and is_integer(b), do: a * b

  def multiply(a, b) when is_number(a) and is_number(b), do: multiply_floats(a, b)

  def multiply(:nan, b), do: nan_if_number(b)
  def multiply(a, :nan), do: nan_if_number(a)
  def multiply(a, b), do: signed_infinity(sign_of(a) * sign_of(b))

  @doc "Divides `a` by `b`. The result is a float; division by zero is infinite, or `:nan` for 0/0."
  @spec divide(t(), t()) :: t()
  def divide(a, b) when is_number(a) and is_number(b) and b != 0, do: divide_floats(a, b)

  def divide(:nan, b), do: nan_if_number(b)
  def divide(a, :nan), do: nan_if_number(a)
  def divide(a, b) when is_number(a) and is_number(b), do: signed_infinity(sign_of(a))
  def divide(a, b) when is_number(b), do: signed_infinity(sign_of(a) * if(b < 0, do: -1, else: 1))
  def divide(a, b) when is_number(a) and b in [:infinity, :neg_infinity], do: 0.0
  def divide(a, b) when a in [:infinity, :neg_infinity], do: nan_if_number(b)

  @doc """
  Interpolates linearly between `a` (ratio 0.0) and `b` (ratio 1.0). Returns `nil` (no value) if either is `nil`.

      iex> Situ.Number.interpolate(10, 20, 0.25)
      12.5
      iex> Situ.Number.interpolate(1, :nan, 0.5)
      :nan
      iex> Situ.Number.interpolate(nil, 3, 0.5)
      nil
  """
  @spec interpolate(t() | nil, t() | nil, float()) :: t() | nil
  def interpolate(nil, b, _ratio),
    do: if(b == nil or number?(b), do: nil, else: raise_not_number(b))

  def interpolate(a, nil, _ratio), do: if(number?(a), do: nil, else: raise_not_number(a))

  def interpolate(a, b, ratio) when is_number(a) and is_number(b) do
    a + (b - a) * ratio
  rescue
    ArithmeticError -> add(multiply(a, 1.0 - ratio), multiply(b, ratio))
  end

  def interpolate(a, b, ratio), do: add(a, multiply(subtract(b, a), ratio))

  @doc "Returns the dot product of two lists."
  @spec dot_product([t()], [t()]) :: t()
  def dot_product(a, b),
    do: Enum.zip_reduce(a, b, 0.0, fn x, y, sum -> add(sum, multiply(x, y)) end)

  @doc """
  Returns the median, or `:nan` if the list contains `:nan`.

      iex> Situ.Number.median([3, :infinity, 1])
      3
      iex> Situ.Number.median([1, 2])
      1.5
  """
  @spec median([t(), ...]) :: t()
  def median(numbers) do
    sorted = sort_numbers(numbers)
    {n, half} = {length(sorted), div(length(sorted), 2)}

    cond do
      :nan in numbers -> :nan
      rem(n, 2) == 1 -> Enum.at(sorted, half)
      true -> divide(add(Enum.at(sorted, half - 1), Enum.at(sorted, half)), 2)
    end
  end

  defp sort_numbers(numbers) do
    if Enum.all?(numbers, &is_number/1),
      do: Enum.sort(numbers),
      else: Enum.sort_by(numbers, &{infinity_rank(&1), &1})
  end

  @doc "Negates a number."
  @spec negate(t()) :: t()
  def negate(:nan), do: :nan
  def negate(:infinity), do: :neg_infinity
  def negate(:neg_infinity), do: :infinity
  def negate(a) when is_number(a), do: -a
  def negate(other), do: raise_not_number(other)

  @doc "Returns the absolute value."
  @spec abs(t()) :: t()
  def abs(a) when is_number(a), do: Kernel.abs(a)
  def abs(:nan), do: :nan
  def abs(a) when a in [:infinity, :neg_infinity], do: :infinity
  def abs(other), do: raise_not_number(other)

  @doc "Returns the smaller number, or `:nan` if either is `:nan`."
  @spec min(t(), t()) :: t()
  def min(a, b) when is_number(a) and is_number(b), do: Kernel.min(a, b)
  def min(a, b), do: pick_by_order(a, b, :lt)

  @doc "Returns the larger number, or `:nan` if either is `:nan`."
  @spec max(t(), t()) :: t()
  def max(a, b) when is_number(a) and is_number(b), do: Kernel.max(a, b)
  def max(a, b), do: pick_by_order(a, b, :gt)

  @doc "Returns the square root; `:nan` for a negative number."
  @spec sqrt(t()) :: t()
  def sqrt(a) when is_number(a) and a >= 0, do: :math.sqrt(a)
  def sqrt(:infinity), do: :infinity
  def sqrt(a), do: nan_if_number(a)

  @doc """
  Returns the natural logarithm: `:neg_infinity` for 0, `:nan` for a negative number.

      iex> Situ.Number.log(0)
      :neg_infinity
  """
  @spec log(t()) :: t()
  def log(a) when is_number(a) and a > 0, do: :math.log(a)
  def log(a) when is_number(a) and a == 0, do: :neg_infinity
  def log(:infinity), do: :infinity
  def log(a), do: nan_if_number(a)

  @doc """
  Decodes a little-endian float of 2, 4 or 8 bytes.

      iex> {Situ.Number.decode_float(<<0, 0x3E>>), Situ.Number.decode_float(<<0, 0, 0x80, 0xFF>>)}
      {1.5, :neg_infinity}
  """
  @spec decode_float(binary()) :: float() | :nan | :infinity | :neg_infinity
  def decode_float(<<x::little-float-64>>), do: x
  def decode_float(<<x::little-float-32>>), do: x
  def decode_float(<<x::little-float-16>>), do: x
  def decode_float(<<0::48, 0xF0, 0x7F>>), do: :infinity
  def decode_float(<<0::48, 0xF0, 0xFF>>), do: :neg_infinity
  def decode_float(<<0, 0, 0x80, 0x7F>>), do: :infinity
  def decode_float(<<0, 0, 0x80, 0xFF>>), do: :neg_infinity
  def decode_float(<<0, 0x7C>>), do: :infinity
  def decode_float(<<0, 0xFC>>), do: :neg_infinity
  def decode_float(bytes) when byte_size(bytes) in [2, 4, 8], do: :nan

  @doc """
  Decodes consecutive little-endian floats of `size` bytes each: 2, 4 or 8.

      iex> Situ.Number.decode_floats(<<1.5::little-float-32, 0, 0, 0xC0, 0x7F>>, 4)
      [1.5, :nan]
  """
  @spec decode_floats(binary(), 2 | 4 | 8) :: [float() | :nan | :infinity | :neg_infinity]
  def decode_floats(bytes, size) do
    bits = size * 8
    floats = for <<x::little-float-pinned_size(bits) <- bytes>>, do: x

    # The comprehension skips NaN and infinities. If it skipped any, every float is decoded separately.
    if length(floats) * size == byte_size(bytes),
      do: floats,
      else: for(<<float::binary-pinned_size(size) <- bytes>>, do: decode_float(float))
  end

  defp pick_by_order(:nan, b, _order), do: nan_if_number(b)
  defp pick_by_order(a, :nan, _order), do: nan_if_number(a)
  defp pick_by_order(a, b, :lt), do: if(infinity_rank(a) <= infinity_rank(b), do: a, else: b)
  defp pick_by_order(a, b, :gt), do: if(infinity_rank(a) >= infinity_rank(b), do: a, else: b)

  # Finite numbers may share a rank, because at least one of the two numbers is infinite here.
  defp infinity_rank(:nan), do: 2
  defp infinity_rank(:infinity), do: 1
  defp infinity_rank(:neg_infinity), do: -1
  defp infinity_rank(a) when is_number(a), do: 0
  defp infinity_rank(other), do: raise_not_number(other)

  defp sign_of(:infinity), do: 1
  defp sign_of(:neg_infinity), do: -1
  defp sign_of(a) when is_number(a) and a > 0, do: 1
  defp sign_of(a) when is_number(a) and a < 0, do: -1
  defp sign_of(a) when is_number(a), do: 0
  defp sign_of(other), do: raise_not_number(other)

  defp signed_infinity(1), do: :infinity
  defp signed_infinity(-1), do: :neg_infinity
  defp signed_infinity(0), do: :nan

  # The Erlang VM raises if IEEE 754 defines an infinite result.
  defp add_floats(a, b) do
    a + b
  rescue
    ArithmeticError -> signed_infinity(sign_of(a))
  end

  defp multiply_floats(a, b) do
    a * b
  rescue
    ArithmeticError -> signed_infinity(sign_of(a) * sign_of(b))
  end

  defp divide_floats(a, b) do
    a / b
  rescue
    ArithmeticError -> signed_infinity(sign_of(a) * sign_of(b))
  end

  defp check_infinite(a) when a in [:infinity, :neg_infinity], do: a
  defp check_infinite(other), do: raise_not_number(other)

  defp nan_if_number(a), do: if(number?(a), do: :nan, else: raise_not_number(a))

  defp raise_not_number(other) do
    raise Situ.Error.new(:not_a_number, "expected a number, got: #{inspect(other, limit: 5)}",
            fix: "map the stream to numbers first, or give the operator by: fn data -> number end"
          )
  end
end
