defmodule Situ.Studio.Annotating.Comparison do
  @moduledoc """
  Measures the agreement of two layers of annotations, as the rows of a table (`Situ.Annotation.Agreement`).

      iex> alias Situ.Annotation.{Layer, Schema}
      iex> schema = Schema.finite("S", ["speaks"])
      iex> {:ok, a} = Layer.new(schema, [Situ.Annotation.new(0, 60_000_000, "P1")])
      iex> {:ok, b} = Layer.new(schema, [Situ.Annotation.new(20_000_000, 60_000_000, "P1")])
      iex> {:ok, rows} = Situ.Studio.Annotating.Comparison.rows(a, b)
      iex> {List.keyfind(rows, "same label", 0), List.keyfind(rows, "begins apart by", 0)}
      {{"same label", "66.7 %"}, {"begins apart by", "20.0 ms"}}
  """
  alias Situ.Annotation.{Agreement, Layer}

  # Bounds the work for long recordings: a longer recording is compared with longer frames.
  @frames 1_000_000
  @finest 10_000_000

  @doc "Returns the measures of agreement as pairs of label and formatted value."
  @spec rows(Layer.t(), Layer.t()) ::
          {:ok, [{String.t(), String.t()}]} | {:error, Situ.Error.t()}
  def rows(a, b) do
    with {:ok, result} <- Agreement.of(a, b, frame: frame(a, b)) do
      {:ok,
       [
         {"attribute", result.attribute},
         {"Cohen's kappa", number(result.kappa)},
         {"same label", percent(result.agreement)},
         {"annotations of both", "#{result.paired}"},
         {"only of the first", "#{result.only_first}"},
         {"only of the second", "#{result.only_second}"},
         {"begins apart by", time(result.begin_error)},
         {"ends apart by", time(result.end_error)}
       ] ++
         for {track, kappa} <- Enum.sort(result.tracks),
             map_size(result.tracks) > 1 do
           {"kappa of #{track}", number(kappa)}
         end}
    end
  end

  defp frame(a, b) do
    times = for layer <- [a, b], x <- Layer.annotations(layer), t <- [x.from, x.to], do: t

    case times do
      [] -> @finest
      times -> max(@finest, div(Enum.max(times) - Enum.min(times), @frames))
    end
  end

  defp number(nil), do: "none: chance explains all"
  defp number(x), do: :erlang.float_to_binary(x / 1, decimals: 3)
  defp percent(nil), do: "none"
  defp percent(x), do: :erlang.float_to_binary(100.0 * x, decimals: 1) <> " %"
  defp time(nil), do: "none in common"
  defp time(ns), do: Situ.Time.format_duration(round(ns))
end
