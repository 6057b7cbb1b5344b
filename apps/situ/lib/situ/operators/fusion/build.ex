defmodule Situ.Fusion.Build do
  @moduledoc false
  # Puts the components of fusion operators into the graph: checks options, names inputs, connects them.
  alias Situ.Fusion.{Form, Fuse, Gather, Merger, Pair, Sampler, Zipper}
  alias Situ.{Error, Interpolator, Options, Pipeline, Stream, Type}

  @common [
    name: [type: :string],
    type: [type: :any],
    policy: [type: :any],
    on_error: [type: {:in, [:stop, :skip, :restart]}],
    async: [type: :boolean]
  ]
  @fusing [
    with: [type: {:fun, 2}],
    flatten: [type: :boolean, default: true],
    give_up_after: [type: :pos_integer]
  ]
  @gathering [ended: [type: {:in, [:stay, :leave]}, default: :stay]]

  @doc "join and fuse, in all their forms."
  @spec attach(String.t(), Form.streams(), Interpolator.t() | [Interpolator.t()], keyword()) ::
          Stream.t()
  def attach(name, {:keyed, _, keyed} = streams, %Interpolator{} = interpolator, opts) do
    opts = Options.validate!(opts, @fusing ++ @gathering ++ @common)
    {primary, secondaries} = Form.sides(streams)
    {creator, type} = Form.plan(streams, [], opts)

    members =
      for {key, index} <- Enum.with_index(Map.keys(keyed)),
          do: {Fuse.input(index), key, interpolator, []}

    options = [
      members: members,
      interpolator: interpolator,
      creator: creator,
      reproducible: name == "Join",
      give_up_after: opts[:give_up_after],
      ended: opts[:ended]
    ]

    add(name, Gather, [{:primary, primary} | named(secondaries)], options, {type, opts})
  end

  def attach(name, streams, interpolator, opts) do
    opts = Options.validate!(opts, @fusing ++ @common)
    {primary, secondaries} = Form.sides(streams)
    interpolators = Form.each(interpolator, length(secondaries))
    types = Enum.zip_with(interpolators, secondaries, &Interpolator.type(&1, &2.type))
    {creator, type} = Form.plan(streams, types, opts)

    options = [
      interpolators: interpolators,
      creator: creator,
      give_up_after: opts[:give_up_after]
    ]

    add(name, Fuse, [{:primary, primary} | named(secondaries)], options, {type, opts})
  end

  @doc "The latest of one stream with each of another."
  @spec pair(Stream.t(), Stream.t(), keyword()) :: Stream.t()
  def pair(primary, secondary, opts) do
    schema = [with: @fusing[:with], flatten: @fusing[:flatten], initial: [type: :any]] ++ @common
    opts = Options.validate!(opts, schema)
    initial = with {:ok, value} <- Keyword.fetch(opts, :initial), do: {:value, value}
    latest = Interpolator.widened(secondary.type, if(initial == :error, do: :none, else: initial))
    {creator, type} = Form.creator(primary.type, latest, opts)
    options = [creator: creator] ++ Keyword.take(opts, [:initial])
    add("Pair", Pair, [primary: primary, secondary: secondary], options, {type, opts})
  end

  @doc "Groups of equal times."
  @spec zip([Stream.t()], keyword()) :: Stream.t()
  def zip(streams, opts) do
    opts = Options.validate!(opts, @common)
    type = {:list, common(streams)}
    add("Zip", Zipper, named(streams), [inputs: length(streams)], {type, opts})
  end

  @doc "Everything as it arrives."
  @spec merge([Stream.t()], keyword()) :: Stream.t()
  def merge(streams, opts) do
    opts = Options.validate!(opts, @common)
    members = for index <- 0..(length(streams) - 1), do: {Fuse.input(index), index}
    add("Merge", Merger, named(streams), [members: members], {{:message, common(streams)}, opts})
  end

  @doc "A stream's values at the ticks of a clock."
  @spec tick(String.t(), Stream.t(), term(), term(), keyword()) :: Stream.t()
  def tick(name, %Stream{} = stream, %Stream{} = clock, interpolator, opts) do
    opts = Options.validate!(opts, [give_up_after: @fusing[:give_up_after]] ++ @common)
    interpolator = Interpolator.from(interpolator)

    options = [
      interpolators: [interpolator],
      creator: fn _tick, value -> value end,
      give_up_after: opts[:give_up_after]
    ]

    type = whole(interpolator, stream.type)
    add(name, Fuse, [primary: clock, s0: stream], options, {type, opts})
  end

  def tick(name, %Stream{} = stream, interval, interpolator, opts)
      when is_integer(interval) and interval > 0 do
    opts = Options.validate!(opts, [align: [type: :time_ns]] ++ @common)
    interpolator = Interpolator.from(interpolator)
    options = [interpolator: interpolator, interval: interval, align: opts[:align]]
    type = whole(interpolator, stream.type)
    add(name, Sampler, [in: stream], options, {type, opts})
  end

  def tick(_name, _stream, clock, _interpolator, _opts) do
    raise ArgumentError,
          "a clock is a stream or an interval of 1 ns or more, got: #{inspect(clock)}"
  end

  # A default comes out as it is here, also in place of a tuple.
  defp whole(%{default: {:value, value}} = interpolator, {:tuple, _} = type) do
    if Type.valid?(type, value), do: Interpolator.type(interpolator, type), else: :any
  end

  defp whole(interpolator, type), do: Interpolator.type(interpolator, type)

  @doc "See `Situ.Fusion.add_input/4`."
  @spec add_input(term(), term(), Stream.t() | String.t(), keyword()) ::
          {:ok, Situ.Time.t() | :start} | {:error, Error.t()}
  def add_input(fused, key, stream, opts) do
    {own, opts} = Keyword.split(opts, [:policy])
    own = Options.validate!(own, policy: [type: {:struct, Situ.Delivery}])
    {pipeline, taker} = at(fused)
    from = of_pipeline(pipeline, stream)

    asked = %{
      taker: taker,
      stream: from,
      policy: own[:policy],
      request: {key, opts},
      input: &Fuse.input/1
    }

    Pipeline.Client.call(pipeline, {:attach, asked})
  end

  @doc "See `Situ.Fusion.remove_input/3`."
  @spec remove_input(term(), term(), keyword()) ::
          {:ok, Situ.Time.t() | :start} | {:error, Error.t()}
  def remove_input(fused, key, opts) do
    {pipeline, taker} = at(fused)
    Pipeline.Client.call(pipeline, {:detach, taker, {key, opts}})
  end

  @doc "Refuses an interpolator that may give other answers at other times."
  @spec reproducible!(Interpolator.t()) :: :ok
  def reproducible!(%Interpolator{reproducible: true}), do: :ok
  def reproducible!(interpolator), do: raise(not_reproducible(interpolator))

  @doc "The error of such an interpolator."
  @spec not_reproducible(Interpolator.t()) :: Error.t()
  def not_reproducible(interpolator) do
    Error.new(
      :not_reproducible,
      "join takes reproducible interpolators, got: #{inspect(interpolator.module)}",
      why: "the answers of the others depend on what has arrived",
      fix: "use Situ.Reproducible, or Situ.fuse/4 where timing may decide"
    )
  end

  defp at(%Stream{} = stream), do: {stream.pipeline, {stream.node, stream.output}}
  defp at({pipeline, name}) when is_binary(name), do: {pipeline, name}

  defp of_pipeline(_pipeline, name) when is_binary(name), do: name

  defp of_pipeline(pipeline, %Stream{} = stream) do
    if Pipeline.Client.pid(pipeline) == stream.pipeline.pid do
      {stream.node, stream.output}
    else
      raise Error.new(
              :different_pipeline,
              "stream #{inspect(stream.name)} belongs to another pipeline",
              fix: "carry the stream over with Situ.Connector"
            )
    end
  end

  defp common(streams), do: streams |> Enum.map(& &1.type) |> Form.common()

  defp named(streams),
    do: for({stream, index} <- Enum.with_index(streams), do: {Fuse.input(index), stream})

  defp add(name, module, [{_, first} | _] = inputs, options, {type, opts}) do
    common =
      [
        name: opts[:name],
        on_error: opts[:on_error],
        async: opts[:async],
        inputs: Enum.map(inputs, fn {input, stream} -> {input, stream.type} end),
        outputs: [out: opts[:type] || type]
      ]
      |> Enum.reject(fn {_, value} -> is_nil(value) end)

    node = Pipeline.add(first.pipeline, module, options, [default_name: name] ++ common)

    inputs
    |> Enum.zip(policies(opts[:policy], length(inputs)))
    |> Enum.each(fn {{input, stream}, policy} ->
      Pipeline.connect(stream, node, input, policy: policy)
    end)

    Situ.Node.output(node, :out)
  end

  defp policies(policies, n) when is_list(policies) and length(policies) == n, do: policies

  defp policies(policies, n) when is_list(policies),
    do: raise(ArgumentError, "#{length(policies)} policies for #{n} inputs")

  defp policies(policy, n), do: List.duplicate(policy, n)
end
