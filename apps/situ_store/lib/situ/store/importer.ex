defmodule Situ.Store.Importer do
  @moduledoc """
  A store that a pipeline replays, created by `Situ.Store.importer/3` and passed to `Situ.Store.stream/3`.

  All importers of a pipeline use its clock. The interval and speed belong to the pipeline (`pipeline: [replay:
  [interval: {from, to}, speed: 4.0]]`), and `Situ.Pipeline.pause/1`, `resume/1` and `set_speed/2` affect all importers.
  `seek/2` and `step/1` move one importer (and the clock).

  ## Seeking and time

  Originating times of a stream only increase, and a pipeline's clock never goes back. Therefore a replay consists of
  *epochs*. Within an epoch, a message's pipeline time is its recorded time plus the epoch's shift, which is 0 at first.
  A seek to a time after all messages handed to the pipeline stays in the epoch, and the clock jumps to that time. Any
  other seek (back, or into the few messages per stream that the pipeline received ahead of its clock) begins a new
  epoch. The messages from the requested time on are replayed again, with times that begin 1 ms after the latest time
  handed out. Creation times are shifted as well, so latencies stay as recorded. A loop does the same at the end of the
  recording, and in a loop every seek begins a new epoch. `position/1` returns the recorded time at the clock's
  position.

  To the components downstream, the recording appears to contain the part twice. Fusion and windows continue across the
  seam as they would across a gap. A stream that has ended stays ended; with `keep_open: true`, streams at their end
  wait for a seek.
  """
  alias Situ.{Clock, Error, Pipeline}
  alias Situ.Recording
  alias Situ.Store.{SchemaEvolution, Playhead, Query, Source, StreamInfo}

  @options [
    loop: [
      type: {:or, [:boolean, :pos_integer]},
      default: false,
      doc:
        "Start over at the end, with times shifted by the store's time span plus 1 ms, or by this period (ns)."
    ],
    keep_open: [
      type: :boolean,
      default: false,
      doc:
        "Wait at the end for a seek, as a player does. The pipeline then runs until it is stopped."
    ],
    skip_damage: [
      type: :boolean,
      default: false,
      doc: "Skip damaged parts. Otherwise they cause an error in the pipeline."
    ],
    verify: [type: {:in, [:all, :small]}, default: :all, doc: "See `Situ.Store.open/2`."]
  ]
  @stream_options [
    type: [type: :any, doc: "The requested type, which the recorded type must match."],
    or_empty: [
      type: :boolean,
      default: false,
      doc: "Return a stream without messages if the store has no stream of this name."
    ],
    name: [type: :string, doc: "The component's name."]
  ]

  @enforce_keys [:store, :pipeline, :head]
  defstruct [
    :store,
    :pipeline,
    :head,
    :period,
    closed?: false,
    keep_open: false,
    skip_damage: false
  ]

  @type t :: %__MODULE__{}

  @doc false
  def open_options, do: @options
  @doc false
  def stream_options, do: @stream_options

  @doc false
  def open_recording(%Situ.Graph.Handle{} = p, path, opts) do
    opts = Situ.Options.validate!(opts, @options)

    store =
      if is_struct(path, Recording), do: path, else: Query.open!(path, verify: opts[:verify])

    %__MODULE__{
      store: store,
      pipeline: p,
      head: Playhead.new(),
      closed?: Query.closed?(store),
      period: loop_period(p, store, opts[:loop]),
      keep_open: opts[:keep_open],
      skip_damage: opts[:skip_damage]
    }
  end

  defp loop_period(_p, _store, false), do: nil

  defp loop_period(_p, store, true) do
    case Query.interval(store) do
      nil -> nil
      {first, last} -> last - first + 1_000_000
    end
  end

  # Each round must begin after the previous one.
  defp loop_period(p, store, ns) do
    {from, _} = Pipeline.replay_interval(p)

    with {first, last} <- Query.interval(store),
         span = last - if(from == :unbounded, do: first, else: max(first, from)),
         true <- ns <= span do
      raise Error.new(:bad_option, "a loop of #{Situ.Time.format_duration(ns)} is too short",
              why:
                "the replayed interval of #{store.path} spans #{Situ.Time.format_duration(span)}",
              fix: "pass a longer period, or `loop: true`"
            )
    end

    ns
  end

  @doc false
  def stream(%__MODULE__{} = importer, name, opts) do
    opts = Situ.Options.validate!(opts, @stream_options)

    case Query.stream_info(importer.store, name) do
      {:ok, info} ->
        add_source(importer, info, opts)

      {:error, error} ->
        if opts[:or_empty], do: add_empty_source(importer, name, opts), else: raise(error)
    end
  end

  defp add_source(importer, info, opts) do
    type = opts[:type]
    if type, do: check_type!(info, type)
    live? = not importer.closed? and Query.live?(importer.store)

    last = if importer.period, do: :unbounded, else: info.last

    if info.first && not live?,
      do: Pipeline.propose_replay(importer.pipeline, {info.first, last})

    {_, asked} = Pipeline.replay_interval(importer.pipeline)
    given = [importer: importer, info: info, type: type, live: live?, to: asked]
    add_component(importer, info, given, opts)
  end

  defp add_empty_source(importer, name, opts) do
    info = %StreamInfo{id: -1, name: name}
    add_component(importer, info, [importer: importer, info: info, type: nil, live: false], opts)
  end

  defp add_component(importer, info, source_opts, opts) do
    name = opts[:name] || String.replace(info.name, ".", " ")
    outputs = [out: opts[:type] || info.type]
    add_named(importer.pipeline, source_opts, outputs, name, if(opts[:name], do: nil, else: 2))
  end

  # Streams of several stores often have the same name, so a number is appended to later ones.
  defp add_named(p, source_opts, outputs, name, next) do
    Situ.source(p, Source, [name: name, outputs: outputs] ++ source_opts)
  rescue
    error in Error ->
      if error.code == :duplicate_name and next != nil,
        do: add_numbered(p, source_opts, outputs, name, next),
        else: reraise(error, __STACKTRACE__)
  end

  defp add_numbered(p, source_opts, outputs, name, next) do
    base = String.replace_suffix(name, " #{next - 1}", "")
    add_named(p, source_opts, outputs, "#{base} #{next}", next + 1)
  end

  defp check_type!(info, type) do
    case SchemaEvolution.check_readable(info, type) do
      :ok -> :ok
      {:error, error} -> raise error
    end
  end

  @doc """
  Continues at the recorded `time`, forward or back. The pipeline's clock jumps as well, whether it is paused or not. A
  few messages per stream that the pipeline already received are still delivered first. The section on seeking in the
  module documentation explains how times are shifted.

  Returns the error `:fixed_clock` if the pipeline runs on the wall clock.
  """
  @spec seek(t(), Situ.Time.t()) :: :ok | {:error, Error.t()}
  def seek(%__MODULE__{} = importer, time) when is_integer(time) do
    clock = Pipeline.clock(importer.pipeline)

    if clock.kind == :real do
      {:error,
       Error.new(:fixed_clock, "a pipeline on the wall clock cannot seek",
         why: "only replayed (virtual) time can jump",
         fix: "start it with a replay interval or with `clock: Situ.Clock.virtual(start)`"
       )}
    else
      anew? = importer.period != nil
      Clock.jump(clock, Playhead.seek_to(importer.head, Clock.now(clock), time, anew?))
    end
  end

  @doc "Returns the recorded time at the position of the pipeline's clock. In a loop it keeps increasing."
  @spec position(t()) :: Situ.Time.t()
  def position(%__MODULE__{} = importer) do
    {_version, _time, shift} = Playhead.read_view(importer.head)
    Clock.now(Pipeline.clock(importer.pipeline)) - shift
  end

  @doc """
  Advances the clock, whether it is paused or not, to the next message of any stream of the store. Returns `{:ok, time}`
  with the message's recorded time, or `{:ok, nil}` at the end.
  """
  @spec step(t()) :: {:ok, Situ.Time.t() | nil} | {:error, Error.t()}
  def step(%__MODULE__{} = importer) do
    clock = Pipeline.clock(importer.pipeline)
    {_version, _time, shift} = Playhead.read_view(importer.head)
    now = Clock.now(clock) - shift

    next =
      for info <- Query.streams(importer.store),
          {:ok, %{originating_time: time}} <- [Query.first_at(importer.store, info, now + 1)],
          do: time

    case next do
      [] ->
        {:ok, nil}

      times ->
        time = Enum.min(times)
        with :ok <- Clock.jump(clock, time + shift), do: {:ok, time}
    end
  end
end
