defmodule Situ.Fusion.GraphBuilder do
  @moduledoc false
  # Adds the components of fusion operators to the graph, names their inputs and connects them.
  alias Situ.Fusion.{
    Arguments,
    FuseComponent,
    MergeComponent,
    Output,
    PairComponent,
    SampleComponent,
    ZipComponent
  }

  alias Situ.{Interpolator, Operator, Stream}

  @typedoc "The operator's options, and its placement options."
  @type options :: {keyword(), keyword()}

  @doc "Adds a join or fuse in any of their forms."
  @spec attach_fusion(
          String.t(),
          Arguments.streams(),
          Interpolator.t() | [Interpolator.t()],
          options()
        ) ::
          Stream.t()
  def attach_fusion(name, {:keyed, _, keyed} = streams, %Interpolator{} = interpolator, options) do
    members =
      for {key, index} <- Enum.with_index(Map.keys(keyed)),
          do: {input_name(index), key, interpolator, []}

    attach_members(name, streams, members, [interpolator: interpolator], options)
  end

  def attach_fusion(_name, {:keyed, _, _}, _interpolators, _options),
    do: raise(ArgumentError, "a map of streams takes one interpolator for all")

  def attach_fusion(name, streams, interpolator, {own, _placement} = options) do
    if own[:ended] == :leave,
      do: raise(ArgumentError, "ended: :leave needs a map of streams")

    {_primary, secondaries} = Arguments.split_sides(streams)
    interpolators = Arguments.interpolator_per_stream(interpolator, length(secondaries))

    members =
      for {one, index} <- Enum.with_index(interpolators), do: {input_name(index), index, one, []}

    attach_members(name, streams, members, [], options)
  end

  defp attach_members(name, streams, members, more, {own, placement}) do
    {primary, secondaries} = Arguments.split_sides(streams)
    interpolators = Enum.map(members, &elem(&1, 2))
    {creator, type, values} = Output.plan_output(streams, interpolators, own)
    options = [members: members, values: values, creator: creator, reproducible: name == "Join"]
    options = options ++ more ++ Keyword.take(own, [:give_up_after, :max_queue, :ended])
    inputs = [{:primary, primary} | name_inputs(secondaries)]
    Operator.attach_component(inputs, name, {FuseComponent, options}, placement, type)
  end

  @doc "Pairs each message of one stream with the latest message of another."
  @spec attach_pair(Stream.t(), Stream.t(), options()) :: Stream.t()
  def attach_pair(primary, secondary, {own, placement}) do
    initial = with {:ok, value} <- Keyword.fetch(own, :initial), do: {:value, value}
    default = if initial == :error, do: :none, else: initial
    {creator, type} = Output.output_creator(primary.type, {secondary.type, default}, own)
    pair = {PairComponent, [creator: creator] ++ Keyword.take(own, [:initial])}

    Operator.attach_component(
      [primary: primary, secondary: secondary],
      "Pair",
      pair,
      placement,
      type
    )
  end

  @doc "Groups messages of equal times."
  @spec attach_zip([Stream.t()], keyword()) :: Stream.t()
  def attach_zip(streams, placement) do
    inputs = name_inputs(streams)
    zipper = {ZipComponent, [names: Keyword.keys(inputs)]}

    Operator.attach_component(
      inputs,
      "Zip",
      zipper,
      placement,
      {:list, common_stream_type(streams)}
    )
  end

  @doc "Merges all messages in order of arrival."
  @spec attach_merge([Stream.t()], keyword()) :: Stream.t()
  def attach_merge(streams, placement) do
    inputs = name_inputs(streams)
    members = for {{input, _}, index} <- Enum.with_index(inputs), do: {input, index}
    type = {:message, common_stream_type(streams)}

    Operator.attach_component(
      inputs,
      "Merge",
      {MergeComponent, [members: members]},
      placement,
      type
    )
  end

  @doc "Emits a stream's values at the ticks of a clock."
  @spec attach_ticks(Stream.t(), term(), Interpolator.t(), options()) :: Stream.t()
  def attach_ticks(%Stream{} = stream, %Stream{} = clock, interpolator, {own, placement}) do
    if own[:align],
      do: raise(ArgumentError, "align: needs an interval, not a stream, as the clock")

    options = [
      members: [{:s0, 0, interpolator, []}],
      values: :one,
      creator: fn _tick, value -> value end
    ]

    options = options ++ Keyword.take(own, [:give_up_after, :max_queue])
    type = Interpolator.value_type(interpolator, stream.type)

    Operator.attach_component(
      [primary: clock, s0: stream],
      "Sample",
      {FuseComponent, options},
      placement,
      type
    )
  end

  def attach_ticks(%Stream{} = stream, interval, interpolator, {own, placement})
      when is_integer(interval) and interval > 0 do
    if own[:give_up_after] || own[:max_queue],
      do: raise(ArgumentError, "give_up_after: and max_queue: need a stream as the clock")

    options = [interpolator: interpolator, interval: interval] ++ Keyword.take(own, [:align])
    type = Interpolator.value_type(interpolator, stream.type)
    Operator.attach_component(stream, "Sample", {SampleComponent, options}, placement, type)
  end

  def attach_ticks(_stream, clock, _interpolator, _options) do
    raise ArgumentError,
          "the clock must be a stream or an interval of 1 ns or more, got: #{inspect(clock)}"
  end

  defp common_stream_type(streams), do: streams |> Enum.map(& &1.type) |> Output.common_type()

  defp name_inputs(streams),
    do: for({stream, index} <- Enum.with_index(streams), do: {input_name(index), stream})

  # Graphs are built by programs, not from untrusted input, so the number of atoms stays small.
  defp input_name(index), do: :"s#{index}"
end
