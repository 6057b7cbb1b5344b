defmodule Situ.Fusion do
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
  @tick [
          align: [
            type: :time_ns,
            doc: "With an interval: aligns ticks to times congruent to this one."
          ]
        ] ++
          @waiting

  @moduledoc """
  Operators that combine streams by time. All functions are also available on `Situ`: `Situ.join/4` ...

  | operator | pairs a message with | output time | reproducible |
  |---|---|---|---|
  | `join/4` | a value from a reproducible interpolator, by default the message at that time | the primary's | yes |
  | `fuse/4` | a value from any interpolator | the primary's | with `Situ.Reproducible` |
  | `pair/3` | the latest message that has arrived | the primary's | no |
  | `zip/2` | all messages of the same time | that time | yes |
  | `merge/2` | nothing: emits complete messages in order of arrival | the clock | no |
  | `sample/4` | a clock tick with the stream's value | the tick's | with `Situ.Reproducible` |

      iex> inputs = [camera: [{0, :c0}, {20, :c20}], tracker: [{2, :door}, {17, :lamp}]]
      iex> Situ.Test.run(inputs, fn s -> Situ.join(s.camera, s.tracker, 5) end)
      {:ok, [{0, {:c0, :door}}, {20, {:c20, :lamp}}]}

  ## Forms

  `join(a, b)` emits `{a, b}`, and `join(a, [b, c])` emits `{a, [b, c]}`. `join([a, b, c])` emits `[a, b, c]`, with
  the first stream as the primary. `join(a, %{left: b, right: c})` emits `{a, %{left: b, right: c}}`, and its inputs
  can be added and removed while it is running (`add_input/4`). If a stream's type is a tuple, as a join's is, its
  elements are flattened: `a |> join(b) |> join(c)` emits `{a, b, c}`. (A default that is not a tuple applies to each
  element of its side.) `with: fun` builds the output with `fun.(primary, secondary)`.

  A tolerance (ns) or a window in place of an interpolator means `Situ.Reproducible.nearest/2`.

  Each primary waits until every secondary can be decided. A secondary that falls silent without ending makes
  primaries wait (see the queue lengths in the diagnostics); `give_up_after:` and `max_queue:` limit this. A lossy
  policy on an input drops messages before the operator sees them. The remaining messages are fused by the same rule,
  but which messages remain depends on timing.

  ## Options

  #{Situ.Options.docs(@fuse)}

  The options of `Situ.Graph.Placement` also apply; `policy:` may be a list with one policy per input, primary first.
  """

  alias Situ.Fusion.{Arguments, GraphBuilder, DynamicInputs}
  alias Situ.Graph.Placement
  alias Situ.{Argument, Interpolator, Interval, Pipeline, Reproducible, Stream}

  @typedoc "An interpolator, a tolerance in ns, or a window."
  @type interpolator :: Interpolator.t() | Situ.Time.duration() | Interval.t()

  @typedoc "Secondary streams by key."
  @type keyed :: %{term() => Stream.t()}

  @doc "Joins streams reproducibly, in the forms above. Rejects interpolators that are not reproducible."
  @spec join(
          Stream.t() | [Stream.t()],
          Stream.t() | [Stream.t()] | keyed() | interpolator() | keyword(),
          interpolator() | keyword(),
          keyword()
        ) :: Stream.t()
  def join(first, second \\ [], third \\ [], opts \\ []) do
    {streams, interpolator, opts} = Arguments.parse_streams(first, second, third, opts)
    interpolator = Arguments.resolve_interpolator(interpolator, Reproducible.exact())
    Enum.each(List.wrap(interpolator), &Arguments.ensure_reproducible!/1)
    GraphBuilder.attach_fusion("Join", streams, interpolator, split_options(opts, @fuse))
  end

  @doc "Fuses streams with any interpolator, in the forms above."
  @spec fuse(
          Stream.t() | [Stream.t()],
          Stream.t() | [Stream.t()] | keyed() | interpolator(),
          interpolator() | keyword(),
          keyword()
        ) :: Stream.t()
  def fuse(first, second, third \\ [], opts \\ []) do
    {streams, interpolator, opts} = Arguments.parse_streams(first, second, third, opts)

    GraphBuilder.attach_fusion(
      "Fuse",
      streams,
      Arguments.resolve_interpolator(interpolator, :none),
      split_options(opts, @fuse)
    )
  end

  @doc """
  Adds a stream to a join or fusion over a map, or to a merge, while the pipeline is running. Its key is `key`.

      fused = Situ.join(image, %{left: left}, Situ.Time.ms(20))
      ...
      {:ok, from} = Situ.Fusion.add_input(fused, :right, right)

  `fused` and `stream` are streams of the same running pipeline, or `{pipeline, name}` and a name. Returns the
  originating time from which the input takes part, or `:start` if no message has arrived yet. Primaries from that
  time on need its value. Earlier primaries are unaffected by it, and its earlier messages are ignored. The default
  is the earliest time for which this is exact: after the last primary that has arrived, and after the last message
  that `stream` has sent. `from:` sets a later time, which makes the outputs independent of the moment of adding. A
  merge takes messages from now on.

  Options: `from:` (ns), `interpolator:` (default: the operator's), `policy:`. Errors: `:too_late` (with the
  `earliest` time in `meta`), `:duplicate_input`, `:not_reproducible`, `:fixed_inputs` (an operator of a different
  form), `:circle` (the stream depends on the operator), `:inside_chain`, `:unknown_stream`, `:not_running`.
  """
  @spec add_input(
          Stream.t() | {Pipeline.target(), String.t()},
          key :: term(),
          Stream.t() | String.t(),
          keyword()
        ) :: {:ok, Situ.Time.t() | :start} | {:error, Situ.Error.t()}
  def add_input(fused, key, stream, opts \\ []),
    do: DynamicInputs.add_input(fused, key, stream, opts)

  @doc """
  Removes the input `key` of a join or fusion over a map, or of a merge, while the pipeline is running. The input may
  have been added later or present from the start.

  Returns the originating time from which primaries no longer need the input, or `:start` if no primary has arrived
  yet. The default, and earliest, time is after the last primary that has arrived; `until:` sets a later time. Earlier
  primaries still wait for the input, and then it is disconnected. Errors: `:too_late`, `:unknown_input`,
  `:fixed_inputs`, `:not_running`.
  """
  @spec remove_input(Stream.t() | {Pipeline.target(), String.t()}, key :: term(), keyword()) ::
          {:ok, Situ.Time.t() | :start} | {:error, Situ.Error.t()}
  def remove_input(fused, key, opts \\ []), do: DynamicInputs.remove_input(fused, key, opts)

  @doc """
  Pairs each primary with the latest secondary that has arrived. Primaries before the first secondary are dropped,
  unless `initial:` is given. Reproducible: no.

  Pairs depend on arrival: when a recording is read as fast as possible (speed `:max`), all primaries may arrive
  before the first secondary, and then there are no pairs. `join/4` with `Situ.Reproducible.last()` returns the latest
  secondary by originating time, at any speed.

  #{Situ.Options.docs(@pair)}
  """
  @spec pair(Stream.t(), Stream.t(), keyword()) :: Stream.t()
  def pair(primary, secondary, opts \\ [])

  def pair(%Stream{} = primary, %Stream{} = secondary, opts),
    do: GraphBuilder.attach_pair(primary, secondary, split_options(opts, @pair))

  def pair(other, _arg2, _arg3),
    do: Argument.raise_invalid!(other, :streams, "Situ.pair(primary, secondary)")

  @doc """
  Groups the messages of all streams by originating time. Each output is the list of messages at that time, in the
  order of the streams. A group is emitted when every stream has reached its time or ended.
  """
  @spec zip(Stream.t() | [Stream.t()], Stream.t() | keyword(), keyword()) :: Stream.t()
  def zip(first, second \\ [], opts \\ []) do
    {streams, opts} = Arguments.parse_inputs(first, second, opts)
    {[], placed} = split_options(opts, [])
    GraphBuilder.attach_zip(streams, placed)
  end

  @doc """
  Emits the messages of all streams as they arrive, each as a complete `Situ.Message`, with the clock's time.
  Reproducible: no.

  Streams can be added and removed while the pipeline is running (`add_input/4`, `remove_input/3`). The initial
  streams have the keys 0, 1, 2 ...
  """
  @spec merge(Stream.t() | [Stream.t()], Stream.t() | keyword(), keyword()) :: Stream.t()
  def merge(first, second \\ [], opts \\ []) do
    {streams, opts} = Arguments.parse_inputs(first, second, opts)
    {[], placed} = split_options(opts, [])
    GraphBuilder.attach_merge(streams, placed)
  end

  @doc """
  Emits the value of a stream at every tick, by default the nearest message.
  """
  @spec sample(
          Stream.t(),
          Stream.t() | Situ.Time.duration(),
          interpolator() | keyword(),
          keyword()
        ) ::
          Stream.t()
  def sample(stream, clock, interpolator \\ Interval.infinite(), opts \\ [])

  def sample(%Stream{} = stream, clock, opts, []) when is_list(opts),
    do: sample(stream, clock, Interval.infinite(), opts)

  def sample(%Stream{} = stream, clock, interpolator, opts) do
    interpolator = Arguments.to_interpolator(interpolator)
    GraphBuilder.attach_ticks(stream, clock, interpolator, split_options(opts, @tick))
  end

  def sample(other, _arg2, _arg3, _arg4),
    do: Argument.raise_invalid!(other, :stream, "Situ.sample(stream, Situ.Time.ms(20))")

  defp split_options(opts, schema), do: Placement.split_options!(opts, schema, :fusion)
end
