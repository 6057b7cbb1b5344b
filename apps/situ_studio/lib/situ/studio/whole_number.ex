defmodule Situ.Studio.WholeNumber do
  @moduledoc """
  Whole numbers of 64 bits as the page sends them: nanoseconds do not fit into JavaScript's numbers, so they come as
  text.

      iex> Situ.Studio.WholeNumber.parse("-1700000000000000001")
      {:ok, -1_700_000_000_000_000_001}
      iex> Enum.map(["", "1.5", "9223372036854775807", nil, 7], &Situ.Studio.WholeNumber.parse/1)
      [:error, :error, :error, :error, :error]
  """

  @doc "The number, or `:error` for anything else."
  @spec parse(term()) :: {:ok, integer()} | :error
  def parse(text) when is_binary(text) and byte_size(text) <= 20 do
    case Integer.parse(text) do
      {number, ""} when abs(number) < 9_223_372_036_854_775_807 -> {:ok, number}
      _ -> :error
    end
  end

  def parse(_), do: :error
end
