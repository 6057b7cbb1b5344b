defmodule Situ.Space.Scan.Text do
  @moduledoc false
  # Numbers as files write them.

  # Elixir's own parser raises where a number of hundreds of digits is no float.
  @most 200

  @doc """
  A number, whole or not, and nothing behind it.

      iex> Situ.Space.Scan.Text.float("1e-3")
      {:ok, 0.001}
      iex> for text <- [".5", "-1.", "2.e3"], do: elem(Situ.Space.Scan.Text.float(text), 1)
      [0.5, -1.0, 2.0e3]
      iex> Situ.Space.Scan.Text.float(String.duplicate("9", 400))
      :error
  """
  @spec float(String.t()) :: {:ok, float()} | :error
  def float(text) when byte_size(text) <= @most do
    case Float.parse(text) do
      {x, ""} -> {:ok, x}
      _ -> short(text)
    end
  end

  def float(_text), do: :error

  # Many write a number without the zero before its point, or behind it; Elixir's parser knows none such.
  defp short(text) do
    case Regex.run(~r/\A([+-]?)(\d*)\.(\d*)([eE][+-]?\d+)?\z/, text) do
      [_, sign, whole, part | exponent] when whole <> part != "" ->
        {x, ""} = Float.parse("#{sign}#{zero(whole)}.#{zero(part)}#{exponent}")
        {:ok, x}

      _ ->
        :error
    end
  end

  defp zero(""), do: "0"
  defp zero(digits), do: digits
end
