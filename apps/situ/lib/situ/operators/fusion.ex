defmodule Situ.Fusion do
  @waiting [
    give_up_after: [
      type: :pos_integer,
      doc:
        "ns: a primary that still waits when a primary this much later has arrived is decided " <>
          "by the messages that are there. " <>
          "The result then depends on timing."
    ],
    max_queue: [
      type: :pos_integer,
      doc:
        "So many primaries, and so many messages of each secondary, wait at most. Sources " <>
          "that can wait are made to; where that does " <>
          "not help the oldest primary is decided by the messages that are there, and the " <>
          "oldest secondary message is dropped. " <>
          "The result then depends on timing."
    ]
  ]
  @with [type: {:fun, 2}, doc: "Makes the output: `fun.(primary, secondary)`."]
  @flatten [type: :boolean, default: true, doc: "Puts tuple-typed sides in flat."]
  @fuse [with: @with, flatten: @flatten] ++
          @waiting ++
          [
            ended: [
              type: {:in, [:stay, :leave]},
              default: :stay,
              doc:
                "Maps: an input that has ended is still asked for (it has no value then), or is left out from then on."
            ]
          ]
  @pair [
    with: @with,
    flatten: @flatten,
    initial: [type: :any, doc: "Stands for the secondary before its first message."]
  ]
  @tick [align: [type: :time_ns, doc: "With an interval: ticks congruent to this time."]] ++
          @waiting

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

  `join(a, b)` gives `{a, b}`; `join(a, [b, c])` gives `{a, [b, c]}`; `join([a, b, c])` gives `[a, b, c]`, its first
  stream being the primary; `join(a, %{left: b, right: c})` gives `{a, %{left: b, right: c}}`, and its inputs may
  come and go (`add_input/4`). Where a stream's type is a tuple (as a join's is), its elements are put in flat: `a
  |> join(b) |> join(c)` gives `{a, b, c}`. (A default that is not a tuple applies to each element of its side.)
  `with: fun` makes the output itself, `fun.(primary, secondary)`.

  A tolerance (ns) or a window in place of an interpolator means `Situ.Reproducible.nearest/2`.

  Primaries wait until every secondary can answer. A secondary that falls silent without ending makes them wait (see
  the queue lengths in the diagnostics): `give_up_after:` and `max_queue:` bound that. A lossy policy on an input
  drops messages before the operator sees them; what is left is fused by the same rule, but which messages are left
  depends on timing.

  ## Options

  #{Situ.Options.docs(@fuse)}

  and those of `Situ.Graph.Placement`, where `policy:` may be a list with one for each input, primary first.
  """

  alias Situ.Fusion.{Arguments, Assembly, DynamicInputs}
  alias Situ.Graph.Placement
  alias Situ.{Argument, Interpolator, Interval, Pipeline, Reproducible, Stream}

  @typedoc "An interpolator, a tolerance in ns, or a window."
  @type interpolator :: Interpolator.t() | Situ.Time.duration() | Interval.t()

  @typedoc "Secondary streams by keys."
  @type keyed :: %{term() => Stream.t()}

  @doc "Reproducible fusion: see the forms above. Refuses interpolators that are not reproducible."
  @spec join(
          Stream.t() | [Stream.t()],
          Stream.t() | [Stream.t()] | keyed() | interpolator() | keyword(),
          interpolator() | keyword(),
          keyword()
        ) :: Stream.t()
  def join(first, second \\ [], third \\ [], opts \\ []) do
    {streams, interpolator, opts} = Arguments.parse(first, second, third, opts)
    interpolator = Arguments.given(interpolator, Reproducible.exact())
    Enum.each(List.wrap(interpolator), &Arguments.reproducible!/1)
    Assembly.fuse("Join", streams, interpolator, split(opts, @fuse))
  end

  @doc "Fusion by any interpolator: see the forms above."
  @spec fuse(
          Stream.t() | [Stream.t()],
          Stream.t() | [Stream.t()] | keyed() | interpolator(),
          interpolator() | keyword(),
          keyword()
        ) :: Stream.t()
  def fuse(first, second, third \\ [], opts \\ []) do
    {streams, interpolator, opts} = Arguments.parse(first, second, third, opts)
    Assembly.fuse("Fuse", streams, Arguments.given(interpolator, :none), split(opts, @fuse))
  end

  @doc """
  Adds a stream to a join or fusion over a map, or to a merge, while the pipeline runs; it takes part under `key`.

      fused = Situ.join(picture, %{left: left}, Situ.Time.ms(20))
      ...
      {:ok, from} = Situ.Fusion.add_input(fused, :right, right)

  `fused` and `stream` are streams of the same running pipeline, or `{pipeline, name}` and a name. Answers the
  originating time from which the input takes part, or `:start` when nothing has come yet: primaries from that time
  on need its value, earlier ones are as if it were not there, and so are its own earlier messages. By default that
  is the earliest time at which this is exact: behind the last primary that has arrived and behind the last message
  that `stream` has sent. `from:` names a later one; the outputs then do not depend on the moment of adding. A merge
  takes messages from now on.

  Options: `from:` (ns), `interpolator:` (default the operator's), `policy:`. Errors: `:too_late` (with the
  `earliest` time in `meta`), `:duplicate_input`, `:not_reproducible`, `:fixed_inputs` (an operator of another
  form), `:circle` (the stream depends on the operator), `:inside_chain`, `:unknown_stream`, `:not_running`.
  """
  @spec add_input(
          Stream.t() | {Pipeline.target(), String.t()},
          key :: term(),
          Stream.t() | String.t(),
          keyword()
        ) :: {:ok, Situ.Time.t() | :start} | {:error, Situ.Error.t()}
  def add_input(fused, key, stream, opts \\ []), do: DynamicInputs.add(fused, key, stream, opts)

  @doc """
  Takes the input `key` of a join or fusion over a map, or of a merge, away while the pipeline runs, whether it was
  added or there from the start.

  Answers the originating time from which primaries do not need it (`:start` when none has come yet): by default,
  and at the earliest, behind the last primary that has arrived; `until:` names a later one. Primaries before that
  still wait for it; then the connection goes. Errors: `:too_late`, `:unknown_input`, `:fixed_inputs`,
  `:not_running`.
  """
  @spec remove_input(Stream.t() | {Pipeline.target(), String.t()}, key :: term(), keyword()) ::
          {:ok, Situ.Time.t() | :start} | {:error, Situ.Error.t()}
  def remove_input(fused, key, opts \\ []), do: DynamicInputs.remove(fused, key, opts)

  @doc """
  Each primary with the latest secondary that has arrived by then; primaries before the first secondary are dropped,
  unless `initial:` gives a value. Reproducible: no.

  Pairs depend on arrival: when a recording is read as fast as possible (speed `:max`), all its primaries may arrive
  before the first secondary, and then there are no pairs. `join/4` with `Situ.Reproducible.last()` gives the latest
  secondary by originating time, at any speed.

  #{Situ.Options.docs(@pair)}
  """
  @spec pair(Stream.t(), Stream.t(), keyword()) :: Stream.t()
  def pair(primary, secondary, opts \\ [])

  def pair(%Stream{} = primary, %Stream{} = secondary, opts),
    do: Assembly.pair(primary, secondary, split(opts, @pair))

  def pair(other, _arg2, _arg3),
    do: Argument.refuse!(other, :streams, "Situ.pair(primary, secondary)")

  @doc """
  The messages of all streams, grouped by originating time: a list of those that share it, in the order of the
  streams. A group goes out when every stream has reached its time or ended.
  """
  @spec zip(Stream.t() | [Stream.t()], Stream.t() | keyword(), keyword()) :: Stream.t()
  def zip(first, second \\ [], opts \\ []) do
    {streams, opts} = Arguments.inputs(first, second, opts)
    {[], placed} = split(opts, [])
    Assembly.zip(streams, placed)
  end

  @doc """
  All messages of all streams as they arrive, each a whole `Situ.Message`, stamped with the clock. Reproducible: no.

  Streams may be added and taken away while it runs (`add_input/4`, `remove_input/3`); those it begins with have the
  keys 0, 1, 2 ...
  """
  @spec merge(Stream.t() | [Stream.t()], Stream.t() | keyword(), keyword()) :: Stream.t()
  def merge(first, second \\ [], opts \\ []) do
    {streams, opts} = Arguments.inputs(first, second, opts)
    {[], placed} = split(opts, [])
    Assembly.merge(streams, placed)
  end

  @doc """
  The stream's value at every tick: of another stream (`clock`), or of an interval in ns, counted from the
  pipeline's start or aligned with `align:` (a time). Ticks end with the stream; one without a value gives nothing.

  #{Situ.Options.docs(@tick)}
  """
  @spec interpolate(Stream.t(), Stream.t() | Situ.Time.duration(), interpolator(), keyword()) ::
          Stream.t()
  def interpolate(stream, clock, interpolator, opts \\ [])

  def interpolate(%Stream{} = stream, clock, interpolator, opts),
    do: tick("Interpolate", stream, clock, interpolator, opts)

  def interpolate(other, _arg2, _arg3, _arg4),
    do:
      Argument.refuse!(
        other,
        :stream,
        "Situ.interpolate(stream, clock, Situ.Reproducible.linear())"
      )

  @doc "As `interpolate/4`, by default with the nearest message: of all, or within a tolerance or window."
  @spec sample(
          Stream.t(),
          Stream.t() | Situ.Time.duration(),
          interpolator() | keyword(),
          keyword()
        ) ::
          Stream.t()
  def sample(stream, clock, window \\ Interval.infinite(), opts \\ [])

  def sample(%Stream{} = stream, clock, opts, []) when is_list(opts),
    do: sample(stream, clock, Interval.infinite(), opts)

  def sample(%Stream{} = stream, clock, window, opts),
    do: tick("Sample", stream, clock, window, opts)

  def sample(other, _arg2, _arg3, _arg4),
    do: Argument.refuse!(other, :stream, "Situ.sample(stream, Situ.Time.ms(20))")

  defp tick(name, %Stream{} = stream, clock, interpolator, opts) do
    interpolator = Arguments.interpolator(interpolator)
    Assembly.tick(name, stream, clock, interpolator, split(opts, @tick))
  end

  defp split(opts, schema), do: Placement.split!(opts, schema, :fusion)
end
