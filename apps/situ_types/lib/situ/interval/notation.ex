defmodule Situ.Interval.Notation do
  @moduledoc false
  # Parses and formats the usual notation of intervals: [0,10), (-inf,0].

  @spec parse_notation(String.t()) ::
          {:ok, Situ.Interval.Overlap.ends()} | {:error, Situ.Error.t()}
  def parse_notation(text) do
    with [_, open, left, right, close] <- Regex.run(~r/^\s*([\[(])(.+),(.+)([\])])\s*$/, text),
         {:ok, left} <- parse_bound(String.trim(left), "-inf"),
         {:ok, right} <- parse_bound(String.trim(right), "inf") do
      {:ok, {left, open == "[", right, close == "]"}}
    else
      _ ->
        {:error,
         Situ.Error.new(:bad_interval, "not an interval: #{inspect(text)}",
           fix: "write it like [0,10), (-inf,0] or [5,inf)"
         )}
    end
  end

  @spec format_notation(Situ.Interval.t()) :: String.t()
  def format_notation(i) do
    open = if i.left_inclusive, do: "[", else: "("
    close = if i.right_inclusive, do: "]", else: ")"
    left = if i.left == :unbounded, do: "-inf", else: "#{i.left}"
    right = if i.right == :unbounded, do: "inf", else: "#{i.right}"
    "#{open}#{left},#{right}#{close}"
  end

  defp parse_bound(text, text), do: {:ok, :unbounded}

  defp parse_bound(text, _unbounded) do
    case {Integer.parse(text), Float.parse(text)} do
      {{integer, ""}, _} -> {:ok, integer}
      {_, {float, ""}} -> {:ok, float}
      _ -> :error
    end
  end
end
