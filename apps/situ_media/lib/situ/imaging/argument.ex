defmodule Situ.Imaging.Argument do
  @moduledoc false
  # Numbers from callers on their way to a kernel: floats of a size that means something, or an error that says which.

  alias Situ.Error

  # Beyond any picture, and far from where floats lose whole numbers.
  @most 1.0e12

  @doc "The values as floats, in order; `what` names them."
  @spec floats([term()], String.t()) :: {:ok, [float()]} | {:error, Error.t()}
  def floats(values, what) do
    case Enum.find(values, &(not (is_number(&1) and &1 <= @most and &1 >= -@most))) do
      nil -> {:ok, Enum.map(values, &(&1 * 1.0))}
      other -> bad("#{what} must be a number between -1.0e12 and 1.0e12, got: #{shown(other)}")
    end
  end

  @doc "The value when it is a whole number of `range`."
  @spec integer(term(), Range.t(), String.t()) :: {:ok, integer()} | {:error, Error.t()}
  def integer(value, range, what) do
    if is_integer(value) and value in range,
      do: {:ok, value},
      else: bad("#{what} must be a whole number of #{inspect(range)}, got: #{shown(value)}")
  end

  @doc "The error `:bad_option`."
  @spec bad(String.t()) :: {:error, Error.t()}
  def bad(text), do: {:error, Error.new(:bad_option, text)}

  # A number of a thousand digits helps nobody.
  defp shown(value), do: inspect(value, limit: 5, printable_limit: 40) |> String.slice(0, 60)
end
