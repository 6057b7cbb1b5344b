defmodule Situ.Studio.Annotations.AgreementTable do
  @moduledoc false
  # Measures the agreement of two layers of annotations, as the rows of a table
  # (`Situ.Annotation.Agreement`).
  alias Situ.Annotation.{Agreement, Layer}

  # Bounds the work for long recordings: a longer recording is compared with longer frames.
  @frames 1_000_000
  @finest 10_000_000

  @doc """
  Returns the measures of agreement as pairs of label and formatted value.

      iex> alias Situ.Annotation.{Layer, Schema}
      iex> schema = Schema.finite("S", ["speaks"])
      iex> {:ok, a} = Layer.new(schema, [Situ.Annotation.new(0, 60_000_000, "P1")])
      iex> {:ok, b} = Layer.new(schema, [Situ.Annotation.new(20_000_000, 60_000_000, "P1")])
      iex> {:ok, rows} = Situ.Studio.Annotations.AgreementTable.agreement_rows(a, b)
      iex> {List.keyfind(rows, "same label", 0), List.keyfind(rows, "mean start difference", 0)}
      {{"same label", "66.7 %"}, {"mean start difference", "20.0 ms"}}
  """
  @spec agreement_rows(Layer.t(), Layer.t()) ::
          {:ok, [{String.t(), String.t()}]} | {:error, Situ.Error.t()}
  def agreement_rows(a, b) do
    with {:ok, result} <- Agreement.compare_layers(a, b, frame: frame_duration(a, b)) do
      {:ok,
       [
         {"attribute", result.attribute},
         {"Cohen's kappa", format_number(result.kappa)},
         {"same label", format_percent(result.agreement)},
         {"annotations in both", "#{result.paired}"},
         {"only in the first", "#{result.only_first}"},
         {"only in the second", "#{result.only_second}"},
         {"mean start difference", format_duration(result.begin_error)},
         {"mean end difference", format_duration(result.end_error)}
       ] ++
         for {track, kappa} <- Enum.sort(result.tracks),
             map_size(result.tracks) > 1 do
           {"kappa of #{track}", format_number(kappa)}
         end}
    end
  end

  defp frame_duration(a, b) do
    times = for layer <- [a, b], x <- Layer.annotations(layer), t <- [x.from, x.to], do: t

    case times do
      [] -> @finest
      times -> max(@finest, div(Enum.max(times) - Enum.min(times), @frames))
    end
  end

  defp format_number(nil), do: "undefined"
  defp format_number(x), do: :erlang.float_to_binary(x / 1, decimals: 3)
  defp format_percent(nil), do: "none"
  defp format_percent(x), do: :erlang.float_to_binary(100.0 * x, decimals: 1) <> " %"
  defp format_duration(nil), do: "no pairs"
  defp format_duration(ns), do: Situ.Time.format_duration(round(ns))
end
