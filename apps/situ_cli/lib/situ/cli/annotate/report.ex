defmodule Situ.CLI.Annotate.Report do
  @moduledoc false
  # Formats the reports of `situ annotate` for people and as JSON: annotation streams, and the agreement of annotators.
  alias Situ.Annotation.{Agreement, Layer, Schema, TierEdit}
  alias Situ.CLI.Output
  alias Situ.Time

  @doc "Returns the tracks, counts and schema of an annotation stream, for `print_layer/1` or JSON."
  @spec describe_layer(String.t(), Layer.t()) :: map()
  def describe_layer(name, layer) do
    all = Layer.annotations(layer)

    %{
      stream: name,
      schema: Schema.to_json(layer.schema),
      annotations: length(all),
      proposals: Enum.count(all, & &1.proposed?),
      tiers: Enum.map(layer.schema.tiers, &TierEdit.describe_tier(layer.schema, &1.name)),
      tracks:
        for(
          track <- Layer.track_names(layer),
          do: %{name: track, annotations: length(Layer.on_track(layer, track))}
        )
    }
  end

  @doc "Prints the description of an annotation stream."
  @spec print_layer(map()) :: :ok
  def print_layer(layer) do
    attributes = Enum.map_join(layer.schema["attributes"], ", ", &"#{&1["name"]} (#{&1["kind"]})")

    proposals =
      if layer.proposals > 0,
        do: ", #{Output.format_count(layer.proposals, "proposal")} among them",
        else: ""

    session = if layer[:session], do: Output.format_name(layer.session) <> "  ", else: ""

    Output.puts(
      "#{session}#{Output.format_name(layer.stream)}: " <>
        "#{Output.format_count(layer.annotations, "annotation")}#{proposals}; #{attributes}"
    )

    for tier <- layer.tiers, do: Output.puts("  tier #{tier}")

    Enum.each(
      layer.tracks,
      &Output.puts("  #{Output.format_name(&1.name)}: #{&1.annotations}")
    )
  end

  @doc "Converts a report of `Situ.Annotation.Agreement` to a map that JSON can contain."
  @spec report_to_json(Agreement.t()) :: map()
  def report_to_json(report) do
    confusion =
      for {{a, b}, n} <- Enum.sort(report.confusion), do: %{first: a, second: b, frames: n}

    %{report | confusion: confusion}
  end

  @doc "Prints a report of `Situ.Annotation.Agreement`."
  @spec print_report(Agreement.t()) :: :ok
  def print_report(report) do
    Output.puts(
      "#{Output.format_name(report.attribute)}: kappa #{format_number(report.kappa)}, " <>
        "agreement #{format_number(report.agreement)} of #{Output.format_count(report.frames, "frame")}"
    )

    for {track, kappa} <- Enum.sort(report.tracks),
        do: Output.puts("  #{Output.format_name(track)}: kappa #{format_number(kappa)}")

    Output.puts(
      "#{Output.format_count(report.paired, "pair")}; begins #{format_span(report.begin_error)} apart, " <>
        "ends #{format_span(report.end_error)}; " <>
        "#{report.only_first} only in the first, #{report.only_second} only in the second"
    )
  end

  defp format_number(nil), do: "-"
  defp format_number(x), do: :erlang.float_to_binary(x, decimals: 4)
  defp format_span(nil), do: "-"
  defp format_span(ns), do: Time.format_duration(round(ns))
end
