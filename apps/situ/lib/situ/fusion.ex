defmodule Situ.Fusion do
  @moduledoc """
  Operators that bring streams together by time. All are on `Situ` too: `Situ.join/4` ...

  | operator | pairs a message with | output's time | reproducible |
  |---|---|---|---|
  | `join/4` | the value a reproducible interpolator gives, by default the message at the very time | primary's | yes |
  | `fuse/4` | the value any interpolator gives | primary's | with `Situ.Reproducible` |
  | `pair/3` | the latest message that has arrived | primary's | no |
  | `zip/2` | all messages of that time | that time | yes |
  | `merge/2` | nothing: whole messages in the order of arrival | the clock | no |
  | `interpolate/4`, `sample/4` | gives a stream's value at the ticks of a clock | tick's | with `Situ.Reproducible` |

      iex> inputs = [camera: [{0, :c0}, {20, :c20}], tracker: [{2, :door}, {17, :lamp}]]
      iex> Situ.Test.run(inputs, fn s -> Situ.join(s.camera, s.tracker, 5) end)
      {:ok, [{0, {:c0, :door}}, {20, {:c20, :lamp}}]}

  ## Forms

  `join(a, b)` gives `{a, b}`; `join(a, [b, c])` gives `{a, [b, c]}`; `join([a, b, c])` gives `[a, b, c]`, its first stream being the primary.
  Where a stream's type is a tuple (as a join's is), its elements are put in flat: `a |> join(b) |> join(c)` gives `{a, b, c}`.
  (A default that is no tuple stands for each element of its side.) `with: fun` makes the output itself, `fun.(primary, secondary)`.

  A tolerance (ns) or a window in place of an interpolator means `Situ.Reproducible.nearest/2`.

  Primaries wait until every secondary can answer. A secondary that falls silent without ending makes them wait (see the queue
  lengths in the diagnostics): `give_up_after:` bounds that. A lossy policy on an input drops messages before the operator sees them; what is
  left is fused by the same rule, but which messages are left depends on timing.

  ## Options

  #{Situ.Options.docs(with: [type: {:fun, 2}, doc: "Makes the output."], flatten: [type: :boolean, default: true, doc: "Put tuple-typed sides in flat."], give_up_after: [type: :pos_integer, doc: "ns: a primary that still waits when a primary this much later has arrived is decided by what is there. The result then depends on timing."], policy: [type: :any, doc: "Delivery policy of the inputs, or a list of them, primary first."])}

  and `name:`, `type:`, `on_error:`, `async:` as for every operator (`Situ.Operator`).
  """

  alias Situ.{Interpolator, Interval, Pipeline, Reproducible, Stream}
  alias Situ.Fusion.{Fuse, Merger, Pair, Sampler, Zipper}

  @typedoc "An interpolator, a tolerance in ns, or a window."
  @type interpolator :: Interpolator.t() | Situ.Time.duration() | Interval.t()

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

  @doc "Reproducible fusion: see the forms above. Refuses interpolators that are not reproducible."
  @spec join(
          Stream.t() | [Stream.t()],
          Stream.t() | [Stream.t()] | interpolator() | keyword(),
          interpolator() | keyword(),
          keyword()
        ) :: Stream.t()
  def join(first, second \\ [], third \\ [], opts \\ []) do
    {streams, interpolator, opts} = arguments(first, second, third, opts)
    interpolator = given(interpolator, Reproducible.exact())
    Enum.each(List.wrap(interpolator), &reproducible!/1)
    attach("Join", streams, interpolator, opts)
  end

  @doc "Fusion by any interpolator: see the forms above."
  @spec fuse(
          Stream.t() | [Stream.t()],
          Stream.t() | [Stream.t()] | interpolator(),
          interpolator() | keyword(),
          keyword()
        ) :: Stream.t()
  def fuse(first, second, third \\ [], opts \\ []) do
    {streams, interpolator, opts} = arguments(first, second, third, opts)
    attach("Fuse", streams, given(interpolator, :none), opts)
  end

  @doc """
  Each primary with the latest secondary that has arrived by then; primaries before the first secondary are dropped, unless
  `initial:` gives a value. Not reproducible.
  """
  @spec pair(Stream.t(), Stream.t(), keyword()) :: Stream.t()
  def pair(%Stream{} = primary, %Stream{} = secondary, opts \\ []) do
    schema = [with: @fusing[:with], flatten: @fusing[:flatten], initial: [type: :any]] ++ @common
    opts = Situ.Options.validate!(opts, schema)
    {creator, type} = creator(primary, secondary, opts)
    options = [creator: creator] ++ Keyword.take(opts, [:initial])
    add("Pair", Pair, [primary: primary, secondary: secondary], options, {type, opts})
  end

  @doc """
  The messages of all streams, grouped by originating time: a list of those that share it, in the order of the streams. A group goes out when
  every stream has reached its time or ended.
  """
  @spec zip(Stream.t() | [Stream.t()], Stream.t() | keyword(), keyword()) :: Stream.t()
  def zip(first, second \\ [], opts \\ []) do
    {streams, opts} = inputs(first, second, opts)
    opts = Situ.Options.validate!(opts, @common)
    add("Zip", Zipper, named(streams), [inputs: length(streams)], {{:list, of(streams)}, opts})
  end

  @doc "All messages of all streams as they arrive, each a whole `Situ.Message`, stamped with the clock. Not reproducible."
  @spec merge(Stream.t() | [Stream.t()], Stream.t() | keyword(), keyword()) :: Stream.t()
  def merge(first, second \\ [], opts \\ []) do
    {streams, opts} = inputs(first, second, opts)
    opts = Situ.Options.validate!(opts, @common)
    add("Merge", Merger, named(streams), [], {{:message, of(streams)}, opts})
  end

  @doc """
  The stream's value at every tick: of another stream (`clock`), or of an interval in ns, counted from the pipeline's start or
  aligned with `align:` (a time). Ticks end with the stream; one without a value gives nothing.
  """
  @spec interpolate(Stream.t(), Stream.t() | Situ.Time.duration(), interpolator(), keyword()) ::
          Stream.t()
  def interpolate(stream, clock, interpolator, opts \\ []),
    do: tick("Interpolate", stream, clock, interpolator, opts)

  @doc "As `interpolate/4`, by default with the nearest message: of all, or within a tolerance or window."
  @spec sample(
          Stream.t(),
          Stream.t() | Situ.Time.duration(),
          interpolator() | keyword(),
          keyword()
        ) ::
          Stream.t()
  def sample(stream, clock, window \\ Interval.infinite(), opts \\ [])

  def sample(stream, clock, opts, []) when is_list(opts),
    do: sample(stream, clock, Interval.infinite(), opts)

  def sample(stream, clock, window, opts), do: tick("Sample", stream, clock, window, opts)

  defp tick(name, %Stream{} = stream, %Stream{} = clock, interpolator, opts) do
    opts = Situ.Options.validate!(opts, [give_up_after: @fusing[:give_up_after]] ++ @common)

    options = [
      interpolators: [Interpolator.from(interpolator)],
      creator: fn _tick, value -> value end,
      give_up_after: opts[:give_up_after]
    ]

    add(name, Fuse, [primary: clock, s0: stream], options, {stream.type, opts})
  end

  defp tick(name, %Stream{} = stream, interval, interpolator, opts)
       when is_integer(interval) and interval > 0 do
    opts = Situ.Options.validate!(opts, [align: [type: :time_ns]] ++ @common)

    options = [
      interpolator: Interpolator.from(interpolator),
      interval: interval,
      align: opts[:align]
    ]

    add(name, Sampler, [in: stream], options, {stream.type, opts})
  end

  defp tick(_name, _stream, clock, _interpolator, _opts) do
    raise ArgumentError,
          "a clock is a stream or an interval of 1 ns or more, got: #{inspect(clock)}"
  end

  # The two shapes of fuse and join: primary with secondaries, or a list whose first is the primary.
  defp arguments(first, second, third, opts) when is_list(first) do
    {interpolator, opts} = last(second, third, opts)
    {{:vector, some!(first)}, interpolator, opts}
  end

  defp arguments(%Stream{} = primary, %Stream{} = secondary, third, opts) do
    {interpolator, opts} = last(third, opts, [])
    {{:one, primary, secondary}, interpolator, opts}
  end

  defp arguments(%Stream{} = primary, secondaries, third, opts) when is_list(secondaries) do
    {interpolator, opts} = last(third, opts, [])
    {{:many, primary, some!(secondaries)}, interpolator, opts}
  end

  defp last(opts, [], []) when is_list(opts) do
    if Keyword.keyword?(opts), do: {:default, opts}, else: {opts, []}
  end

  defp last([], opts, []), do: {:default, opts}
  defp last(interpolator, opts, []), do: {interpolator, opts}
  defp last(interpolator, [], opts), do: {interpolator, opts}

  defp given(:default, :none), do: raise(ArgumentError, "fuse needs an interpolator; see join")
  defp given(:default, default), do: default
  defp given(list, _default) when is_list(list), do: Enum.map(list, &Interpolator.from/1)
  defp given(other, _default), do: Interpolator.from(other)

  defp reproducible!(%Interpolator{reproducible: true}), do: :ok

  defp reproducible!(interpolator) do
    raise Situ.Error.new(
            :not_reproducible,
            "join takes reproducible interpolators, got: #{inspect(interpolator.module)}",
            why: "the answers of the others depend on what has arrived",
            fix: "use Situ.Reproducible, or Situ.fuse/4 where timing may decide"
          )
  end

  defp attach(name, streams, interpolator, opts) do
    opts = Situ.Options.validate!(opts, @fusing ++ @common)
    {primary, secondaries, creator, type} = plan(streams, opts)

    options = [
      interpolators: each(interpolator, length(secondaries)),
      creator: creator,
      give_up_after: opts[:give_up_after]
    ]

    add(name, Fuse, [{:primary, primary} | named(secondaries)], options, {type, opts})
  end

  defp each(%Interpolator{} = one, n), do: List.duplicate(one, n)
  defp each(list, n) when length(list) == n, do: list

  defp each(list, n),
    do: raise(ArgumentError, "#{length(list)} interpolators for #{n} secondary streams")

  defp plan({:one, primary, secondary}, opts) do
    {creator, type} = creator(primary, secondary, opts)
    {primary, [secondary], creator, type}
  end

  defp plan({:many, primary, [only]}, opts) do
    creator = opts[:with] || (&{&1, &2})
    type = {:tuple, [primary.type, {:list, only.type}]}
    {primary, [only], fn p, s -> creator.(p, [s]) end, type(type, opts)}
  end

  defp plan({:many, primary, secondaries}, opts) do
    type = {:tuple, [primary.type, {:list, of(secondaries)}]}
    {primary, secondaries, opts[:with] || (&{&1, &2}), type(type, opts)}
  end

  defp plan({:vector, [primary, only]}, opts) do
    creator = vector(opts)
    {primary, [only], fn p, s -> creator.(p, [s]) end, type({:list, of([primary, only])}, opts)}
  end

  defp plan({:vector, [primary | secondaries] = all}, opts) do
    {primary, secondaries, vector(opts), type({:list, of(all)}, opts)}
  end

  defp vector(opts), do: opts[:with] || fn p, s -> [p | s] end

  defp type(default, opts), do: if(opts[:with], do: :any, else: default)

  defp creator(primary, secondary, opts) do
    cond do
      opts[:with] -> {opts[:with], :any}
      opts[:flatten] == false -> {&{&1, &2}, {:tuple, [primary.type, secondary.type]}}
      true -> flat(primary.type, secondary.type)
    end
  end

  defp flat({:tuple, a}, {:tuple, b}) do
    n = length(b)
    {&List.to_tuple(Tuple.to_list(&1) ++ Tuple.to_list(wide(&2, n))), {:tuple, a ++ b}}
  end

  defp flat({:tuple, a}, b), do: {&Tuple.append(&1, &2), {:tuple, a ++ [b]}}

  defp flat(a, {:tuple, b}) do
    n = length(b)
    {&Tuple.insert_at(wide(&2, n), 0, &1), {:tuple, [a | b]}}
  end

  defp flat(a, b), do: {&{&1, &2}, {:tuple, [a, b]}}

  # A default that stands for a tuple stands for each of its elements.
  defp wide(tuple, _n) when is_tuple(tuple), do: tuple
  defp wide(default, n), do: Tuple.duplicate(default, n)

  defp inputs(%Stream{} = first, %Stream{} = second, opts), do: {[first, second], opts}
  defp inputs(streams, opts, []) when is_list(streams), do: {some!(streams), opts}

  defp some!([]), do: raise(ArgumentError, "no streams given: there is nothing to bring together")

  defp some!(streams) do
    if Enum.all?(streams, &is_struct(&1, Stream)),
      do: streams,
      else: raise(ArgumentError, "expected streams, got: #{inspect(streams, limit: 5)}")
  end

  defp named(streams),
    do: for({stream, index} <- Enum.with_index(streams), do: {Fuse.input(index), stream})

  # The type that all of them have, or any.
  defp of(streams) do
    case streams |> Enum.map(& &1.type) |> Enum.uniq() do
      [type] -> type
      _ -> :any
    end
  end

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
