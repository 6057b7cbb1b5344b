defmodule Situ.Studio.Int64 do
  @moduledoc false
  # Parses 64-bit integers from the page. Nanoseconds exceed the exact range of JavaScript
  # numbers, so the page sends them as strings.

  @doc """
  Returns the integer, or `:error` for any other input.

      iex> Situ.Studio.Int64.parse("-1700000000000000001")
      {:ok, -1_700_000_000_000_000_001}
      iex> Enum.map(["", "1.5", "9223372036854775807", nil, 7], &Situ.Studio.Int64.parse/1)
      [:error, :error, :error, :error, :error]
  """
  @spec parse(term()) :: {:ok, integer()} | :error
  def parse(text) when is_binary(text) and byte_size(text) <= 20 do
    case Integer.parse(text) do
      {number, ""} when abs(number) < 9_223_372_036_854_775_807 -> {:ok, number}
      _ -> :error
    end
  end

  def parse(_), do: :error
end
