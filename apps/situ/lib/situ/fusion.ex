defmodule Situ.Fusion do
  @moduledoc false
  # Operators that combine streams by time: joins, fusions, pairs, zips, merges and samples. `Situ` documents them.

  @waiting [
    give_up_after: [
      type: :pos_integer,
      doc:
        "Maximum wait, ns. When a primary this much later has arrived, a waiting primary is decided " <>
          "using the messages that have arrived. " <>
          "The result then depends on timing."
    ],
    max_queue: [
      type: :pos_integer,
      doc:
        "Maximum number of waiting primaries, and of waiting messages of each secondary. " <>
          "Sources that can wait are paused; if that is not enough, " <>
          "the oldest primary is decided using the messages that have arrived, and the " <>
          "oldest secondary message is dropped. " <>
          "The result then depends on timing."
    ]
  ]
  @with [type: {:fun, 2}, doc: "Builds the output: `fun.(primary, secondary)`."]
  @flatten [type: :boolean, default: true, doc: "Flattens tuple-typed sides into one tuple."]
  @fuse [with: @with, flatten: @flatten] ++
          @waiting ++
          [
            ended: [
              type: {:in, [:stay, :leave]},
              default: :stay,
              doc:
                "For maps: whether an input that has ended is still queried (`:stay`; it then has no value) " <>
                  "or is left out from then on (`:leave`)."
            ]
          ]
  @pair [
    with: @with,
    flatten: @flatten,
    initial: [type: :any, doc: "The secondary value before the first secondary message."]
  ]
  @sample [
            align: [
              type: :time_ns,
              doc: "With an interval: aligns ticks to times congruent to this one."
            ]
          ] ++
            @waiting

  alias Situ.Fusion.{Arguments, GraphBuilder}
  alias Situ.Graph.Placement
  alias Situ.{Argument, Interval, Reproducible, Stream}

  @spec option_schema(:fuse | :pair | :sample) :: Situ.Options.schema()
  def option_schema(:fuse), do: @fuse
  def option_schema(:pair), do: @pair
  def option_schema(:sample), do: @sample

  def join(first, second, third, opts) do
    {streams, interpolator, opts} = Arguments.parse_streams(first, second, third, opts)
    interpolator = Arguments.resolve_interpolator(interpolator, Reproducible.exact())
    Enum.each(List.wrap(interpolator), &Arguments.ensure_reproducible!/1)
    GraphBuilder.attach_fusion("Join", streams, interpolator, split_options(opts, @fuse))
  end

  def fuse(first, second, third, opts) do
    {streams, interpolator, opts} = Arguments.parse_streams(first, second, third, opts)

    GraphBuilder.attach_fusion(
      "Fuse",
      streams,
      Arguments.resolve_interpolator(interpolator, :none),
      split_options(opts, @fuse)
    )
  end

  def pair(%Stream{} = primary, %Stream{} = secondary, opts),
    do: GraphBuilder.attach_pair(primary, secondary, split_options(opts, @pair))

  def pair(other, _arg2, _arg3),
    do: Argument.raise_invalid!(other, :streams, "Situ.pair(primary, secondary)")

  def zip(first, second, opts) do
    {streams, opts} = Arguments.parse_inputs(first, second, opts)
    {[], placement} = split_options(opts, [])
    GraphBuilder.attach_zip(streams, placement)
  end

  def merge(first, second, opts) do
    {streams, opts} = Arguments.parse_inputs(first, second, opts)
    {[], placement} = split_options(opts, [])
    GraphBuilder.attach_merge(streams, placement)
  end

  def sample(%Stream{} = stream, clock, opts, []) when is_list(opts),
    do: sample(stream, clock, Interval.infinite(), opts)

  def sample(%Stream{} = stream, clock, interpolator, opts) do
    interpolator = Arguments.to_interpolator(interpolator)
    GraphBuilder.attach_ticks(stream, clock, interpolator, split_options(opts, @sample))
  end

  def sample(other, _arg2, _arg3, _arg4),
    do: Argument.raise_invalid!(other, :stream, "Situ.sample(stream, Situ.Time.ms(20))")

  defp split_options(opts, schema), do: Placement.split_options!(opts, schema, :fusion)
end
