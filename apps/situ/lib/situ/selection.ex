defmodule Situ.Selection do
  @process [
    on_close: [
      type: {:fun, 2},
      doc:
        "Returns a last list of `{time, data}` at the stream's end: `fun.(closing_time, state)`."
    ]
  ]
  @reorder [
    time: [
      type: {:fun, 1},
      doc: "Returns the time of a message, ns; by default its originating time."
    ],
    late: [
      type: {:in, [:drop, :error]},
      default: :drop,
      doc: "Whether a message beyond the allowed lateness is dropped or is an error."
    ]
  ]

  @moduledoc """
  Operators that select, move, edit and re-time messages. All functions are also available on `Situ`: `Situ.first/2` ...

  | operator | emits | output time |
  |---|---|---|
  | `first/3` | the first n messages, then nothing | the input's |
  | `last/3` | the last n messages, when the stream ends | their own |
  | `map_present/3` | `fun` of the data, and `nil` for `nil` | the input's |
  | `time_of/2` | the originating time as data | the input's |
  | `latency/2` | creation time minus originating time as data | the input's |
  | `delay/3` | each message some time after its creation | the input's |
  | `process/4` | any number of messages, returned by `fun` | as returned by `fun` |
  | `edit/3` | the stream with messages replaced, inserted and deleted | the input's or the edit's |
  | `reorder/3` | messages in order, up to a lateness | as returned by `time:` |

      iex> Situ.to_list(fn p -> p |> Situ.from_enumerable(1..9, every: 10) |> Situ.last(2) end)
      [8, 9]

  All except `latency/2`, which shows timing, are reproducible.
  All take the options of every operator (`Situ.Graph.Placement`).
  """

  alias Situ.Graph.Placement
  alias Situ.{Argument, Generator, Operator, Stream}
  alias Situ.Selection.{Delay, Edit, Last, Process, Reorder}

  @doc "Emits the first `n` messages. The stream then stays open without further messages."
  @spec first(Stream.t(), non_neg_integer(), keyword()) :: Stream.t()
  def first(stream, n \\ 1, opts \\ [])

  def first(%Stream{} = stream, opts, []) when is_list(opts), do: first(stream, 1, opts)

  def first(%Stream{} = stream, n, opts) when is_integer(n) and n >= 0 do
    step = fn
      _data, _message, 0 -> {:skip, 0}
      data, _message, left -> {:emit, data, left - 1}
    end

    Operator.attach(stream, "First", {:step, step, n}, opts, stream.type)
  end

  def first(other, _arg2, _arg3),
    do: Argument.raise_invalid!(other, :stream, "Situ.first(stream, 3)")

  @doc "Emits the last `n` messages, with their times, when the stream ends."
  @spec last(Stream.t(), non_neg_integer(), keyword()) :: Stream.t()
  def last(stream, n \\ 1, opts \\ [])

  def last(%Stream{} = stream, opts, []) when is_list(opts), do: last(stream, 1, opts)

  def last(%Stream{} = stream, n, opts) when is_integer(n) and n >= 0,
    do: Operator.attach_component(stream, "Last", {Last, [count: n]}, opts, stream.type)

  def last(other, _arg2, _arg3),
    do: Argument.raise_invalid!(other, :stream, "Situ.last(stream, 3)")

  @doc "Applies `fun` to the data, except that `nil` stays `nil`."
  @spec map_present(Stream.t(), (term() -> term()), keyword()) :: Stream.t()
  def map_present(stream, fun, opts \\ [])

  def map_present(%Stream{} = stream, fun, opts) when is_function(fun, 1) do
    Operator.attach(stream, "MapPresent", {:map, &if(&1 == nil, do: nil, else: fun.(&1))}, opts)
  end

  def map_present(other, _arg2, _arg3),
    do: Argument.raise_invalid!(other, :stream, "Situ.map_present(stream, fn data -> data end)")

  @doc "Emits the originating time of each message as its data, ns."
  @spec time_of(Stream.t(), keyword()) :: Stream.t()
  def time_of(stream, opts \\ [])

  def time_of(%Stream{} = stream, opts) do
    step = {:map, fn _data, message -> message.originating_time end}
    Operator.attach(stream, "TimeOf", step, opts, :integer)
  end

  def time_of(other, _arg2), do: Argument.raise_invalid!(other, :stream, "Situ.time_of(stream)")

  @doc """
  Emits creation time minus originating time of each message as its data, ns, which is how late the message is here.
  Reproducible: no.
  """
  @spec latency(Stream.t(), keyword()) :: Stream.t()
  def latency(stream, opts \\ [])

  def latency(%Stream{} = stream, opts) do
    step = {:map, fn _data, message -> Situ.Message.latency(message) end}
    Operator.attach(stream, "Latency", step, Keyword.put_new(opts, :async, true), :integer)
  end

  def latency(other, _arg2), do: Argument.raise_invalid!(other, :stream, "Situ.latency(stream)")

  @doc """
  Holds each message until its creation time plus `duration` (ns) on the pipeline's clock. Its times and data are
  unchanged, and no message is lost: when the stream ends, the held messages are emitted immediately. Without an
  enforced clock (speed `:max`), messages are not held.

  Reproducible: yes. The clock decides when a message is emitted, not whether it is. Operators that depend on arrival
  (`pair/3`, `merge/3`) see it later.
  """
  @spec delay(Stream.t(), Situ.Time.duration(), keyword()) :: Stream.t()
  def delay(stream, duration, opts \\ [])

  def delay(%Stream{} = stream, duration, opts) when is_integer(duration) and duration >= 0,
    do:
      Operator.attach_component(stream, "Delay", {Delay, [duration: duration]}, opts, stream.type)

  def delay(other, _arg2, _arg3),
    do: Argument.raise_invalid!(other, :stream, "Situ.delay(stream, Situ.Time.ms(20))")

  @doc """
  Emits any number of messages for each input message: `fun.(message, state)` returns `{[{time, data}], state}`. Times
  must strictly increase.

  #{Situ.Options.docs(@process)}

      # Emits each word of a sentence as a separate message, 1 ns apart.
      Situ.process(sentences, nil, fn message, state ->
        words = String.split(message.data)
        {Enum.with_index(words, fn word, i -> {message.originating_time + i, word} end), state}
      end)
  """
  @spec process(
          Stream.t(),
          state,
          (Situ.Message.t(), state -> {[{Situ.Time.t(), term()}], state}),
          keyword()
        ) ::
          Stream.t()
        when state: term()
  def process(stream, state, fun, opts \\ [])

  def process(%Stream{} = stream, state, fun, opts) when is_function(fun, 2) do
    {own, placed} = Placement.split_options!(opts, @process, :operator)

    Operator.attach_component(
      stream,
      "Process",
      {Process, [state: state, fun: fun] ++ own},
      placed
    )
  end

  def process(other, _arg2, _arg3, _arg4),
    do:
      Argument.raise_invalid!(
        other,
        :stream,
        "Situ.process(stream, state, fn message, state -> {[], state} end)"
      )

  @doc """
  Applies edits to a stream: `{time, {:put, data}}` replaces the message at that time or inserts one, and `{time,
  :delete}` removes it. Edits may be in any order; the last of several edits at one time applies.
  """
  @spec edit(Stream.t(), [{Situ.Time.t(), {:put, term()} | :delete}], keyword()) :: Stream.t()
  def edit(stream, edits, opts \\ [])

  def edit(%Stream{} = stream, edits, opts) when is_list(edits) do
    edits = Generator.from_enumerable(stream.pipeline, Edit.sort_edits(edits))
    Operator.attach_component([in: stream, edits: edits], "Edit", {Edit, []}, opts, stream.type)
  end

  def edit(other, _arg2, _arg3),
    do: Argument.raise_invalid!(other, :stream, "Situ.edit(stream, [{time, :delete}])")

  @doc """
  Orders messages by a separate time (such as a device's timestamp). Each message waits until a message more than
  `lateness` ns later has arrived, or the stream ends. The first of several messages at one time is kept.

  #{Situ.Options.docs(@reorder)}
  """
  @spec reorder(Stream.t(), Situ.Time.duration(), keyword()) :: Stream.t()
  def reorder(stream, lateness, opts \\ [])

  def reorder(%Stream{} = stream, lateness, opts)
      when is_integer(lateness) and lateness >= 0 do
    {own, placed} = Placement.split_options!(opts, @reorder, :operator)
    own = Keyword.put_new(own, :time, & &1.originating_time)

    Operator.attach_component(
      stream,
      "Reorder",
      {Reorder, [lateness: lateness] ++ own},
      placed,
      stream.type
    )
  end

  def reorder(other, _arg2, _arg3),
    do: Argument.raise_invalid!(other, :stream, "Situ.reorder(stream, Situ.Time.ms(20))")
end
