defmodule Situ.ImageOps.ArgumentCheck do
  @moduledoc false
  # Validates numbers from callers before they are passed to a kernel, and returns errors that name the argument.

  alias Situ.Error

  # Larger than any image, and far below the limit where floats lose integer precision.
  @most 1.0e12

  @doc "Converts the values to floats, in order. `what` names them in errors."
  @spec check_floats([term()], String.t()) :: {:ok, [float()]} | {:error, Error.t()}
  def check_floats(values, what) do
    case Enum.find(values, &(not (is_number(&1) and &1 <= @most and &1 >= -@most))) do
      nil ->
        {:ok, Enum.map(values, &(&1 * 1.0))}

      other ->
        bad_option(
          "#{what} must be a number between -1.0e12 and 1.0e12, got: #{shorten_value(other)}"
        )
    end
  end

  @doc "Returns the value if it is an integer in `range`."
  @spec check_integer(term(), Range.t(), String.t()) :: {:ok, integer()} | {:error, Error.t()}
  def check_integer(value, range, what) do
    if is_integer(value) and value in range,
      do: {:ok, value},
      else:
        bad_option(
          "#{what} must be an integer in #{inspect(range)}, got: #{shorten_value(value)}"
        )
  end

  @doc "Builds the error `:bad_option`."
  @spec bad_option(String.t()) :: {:error, Error.t()}
  def bad_option(text), do: {:error, Error.new(:bad_option, text)}

  # Limits the length, since a number with a thousand digits would make the error unreadable.
  defp shorten_value(value),
    do: inspect(value, limit: 5, printable_limit: 40) |> String.slice(0, 60)
end
