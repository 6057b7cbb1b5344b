defmodule Situ.Space.Scan.Text do
  @moduledoc false
  # Numbers as files write them.

  # Elixir's own parser raises where a number of hundreds of digits is no float.
  @most 200

  @doc """
  A number, whole or not, and nothing behind it.

      iex> Situ.Space.Scan.Text.float("1e-3")
      {:ok, 0.001}
      iex> Situ.Space.Scan.Text.float(String.duplicate("9", 400))
      :error
  """
  @spec float(String.t()) :: {:ok, float()} | :error
  def float(text) when byte_size(text) <= @most do
    case Float.parse(text) do
      {x, ""} -> {:ok, x}
      _ -> :error
    end
  end

  def float(_text), do: :error
end
