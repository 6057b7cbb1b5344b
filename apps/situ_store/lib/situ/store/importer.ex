defmodule Situ.Store.Importer do
  @moduledoc """
  A store being replayed by a pipeline: what `Situ.Store.importer/3` returns and `Situ.Store.stream/3` takes.

  All importers of a pipeline run on its clock: an interval and a speed are the pipeline's (`pipeline: [replay:
  [interval: {from, to}, speed: 4.0]]`), `Situ.Pipeline.pause/1`, `resume/1` and `set_speed/2` act on all of them;
  `seek/2` and `step/1` move one importer (and the clock).

  ## Seeking, and what happens to time

  Originating times of a stream only increase, and a pipeline's clock never goes back. So a replay is a row of
  *epochs*: in each, a message's time in the pipeline is its recorded time plus the epoch's shift, 0 at first. A seek
  beyond everything that was handed to the pipeline stays in the epoch, and the clock jumps there. Any other (back, or
  within the few messages per stream that the pipeline was handed ahead of its clock) begins a new one: the messages
  from the sought time on come again, with times that begin 1 ms after the latest one handed out; creation times move
  along, so latencies stay those of the recording. A loop does the same at the recording's end, and with one every
  seek begins an epoch. `position/1` tells the recorded time that is played.

  To what comes out it looks as if the recording contained the part again: fusion and windows go on over the seam, as
  they would over a gap. A stream that has ended stays ended; with `keep_open: true` streams wait at their ends to be
  sought.
  """
  alias Situ.{Clock, Error, Pipeline}
  alias Situ.Store.{Evolution, Handle, Playhead, Reading, Source, StreamInfo}

  @options [
    loop: [
      type: {:or, [:boolean, :pos_integer]},
      default: false,
      doc:
        "Start over at the end, times shifted by the store's span and 1 ms, or by this period (ns)."
    ],
    keep_open: [
      type: :boolean,
      default: false,
      doc:
        "Wait at the end for a seek, as a player does; the pipeline then runs until it is stopped."
    ],
    skip_damage: [
      type: :boolean,
      default: false,
      doc: "Go on behind damaged parts; else they are an error of the pipeline."
    ],
    verify: [type: {:in, [:all, :small]}, default: :all, doc: "As `Situ.Store.open/2`."]
  ]
  @stream_options [
    type: [type: :any, doc: "The type wanted; the recorded one must fit."],
    or_empty: [
      type: :boolean,
      default: false,
      doc: "A stream without messages when it is missing."
    ],
    name: [type: :string, doc: "The component's name."]
  ]

  @enforce_keys [:store, :pipeline, :head]
  defstruct [:store, :pipeline, :head, :period, keep_open: false, skip_damage: false]
  @type t :: %__MODULE__{}

  @doc false
  def options, do: @options
  @doc false
  def stream_options, do: @stream_options

  @doc false
  def open(%Situ.Graph.Handle{} = p, path, opts) do
    opts = Situ.Options.validate!(opts, @options)
    store = if is_struct(path, Handle), do: path, else: Reading.open!(path, verify: opts[:verify])

    %__MODULE__{
      store: store,
      pipeline: p,
      head: Playhead.new(),
      period: period(p, store, opts[:loop]),
      keep_open: opts[:keep_open],
      skip_damage: opts[:skip_damage]
    }
  end

  defp period(_p, _store, false), do: nil

  defp period(_p, store, true) do
    case Reading.interval(store) do
      nil -> nil
      {first, last} -> last - first + 1_000_000
    end
  end

  # Each round begins behind the one before it.
  defp period(p, store, ns) do
    {from, _} = Pipeline.replay_interval(p)

    with {first, last} <- Reading.interval(store),
         span = last - if(from == :unbounded, do: first, else: max(first, from)),
         true <- ns <= span do
      raise Error.new(:bad_option, "a loop of #{Situ.Time.format_duration(ns)} is too short",
              why:
                "the interval played of #{store.path} spans #{Situ.Time.format_duration(span)}",
              fix: "give more than that, or loop: true"
            )
    end

    ns
  end

  @doc false
  def stream(%__MODULE__{} = importer, name, opts) do
    opts = Situ.Options.validate!(opts, @stream_options)

    case Reading.stream_info(importer.store, name) do
      {:ok, info} -> source(importer, info, opts)
      {:error, error} -> if opts[:or_empty], do: empty(importer, name, opts), else: raise(error)
    end
  end

  defp source(importer, info, opts) do
    type = opts[:type]
    if type, do: check!(info, type)
    live? = Reading.live?(importer.store)

    last = if importer.period, do: :unbounded, else: info.last

    if info.first && not live?,
      do: Pipeline.propose_replay(importer.pipeline, {info.first, last})

    {_, asked} = Pipeline.replay_interval(importer.pipeline)
    given = [importer: importer, info: info, type: type, live: live?, to: asked]
    add(importer, info, given, opts)
  end

  defp empty(importer, name, opts) do
    info = %StreamInfo{id: -1, name: name}
    add(importer, info, [importer: importer, info: info, type: nil, live: false], opts)
  end

  defp add(importer, info, source_opts, opts) do
    name = opts[:name] || String.replace(info.name, ".", " ")
    outputs = [out: opts[:type] || info.type]
    named(importer.pipeline, source_opts, outputs, name, if(opts[:name], do: nil, else: 2))
  end

  # Streams of several stores often have the same name: the later ones get a number.
  defp named(p, source_opts, outputs, name, next) do
    Situ.source(p, Source, [name: name, outputs: outputs] ++ source_opts)
  rescue
    error in Error ->
      if error.code == :duplicate_name and next != nil,
        do: numbered(p, source_opts, outputs, name, next),
        else: reraise(error, __STACKTRACE__)
  end

  defp numbered(p, source_opts, outputs, name, next) do
    base = String.replace_suffix(name, " #{next - 1}", "")
    named(p, source_opts, outputs, "#{base} #{next}", next + 1)
  end

  defp check!(info, type) do
    case Evolution.check(info, type) do
      :ok -> :ok
      {:error, error} -> raise error
    end
  end

  @doc """
  Goes on at the recorded `time`, forward or back; the pipeline's clock jumps along, paused or not. A few messages per
  stream that were already handed to the pipeline still come before. See above for what the times become.

  Errors: `:fixed_clock` when the pipeline runs on the wall clock.
  """
  @spec seek(t(), Situ.Time.t()) :: :ok | {:error, Error.t()}
  def seek(%__MODULE__{} = importer, time) when is_integer(time) do
    clock = Pipeline.clock(importer.pipeline)

    if clock.kind == :real do
      {:error,
       Error.new(:fixed_clock, "a pipeline on the wall clock cannot seek",
         why: "only replayed (virtual) time can jump",
         fix: "start it with a replay interval, or with clock: Situ.Clock.virtual(start)"
       )}
    else
      anew? = importer.period != nil
      Clock.jump(clock, Playhead.seek(importer.head, Clock.now(clock), time, anew?))
    end
  end

  @doc "The recorded time that the pipeline's clock stands at. In a loop it goes on counting."
  @spec position(t()) :: Situ.Time.t()
  def position(%__MODULE__{} = importer) do
    {_version, _time, shift} = Playhead.view(importer.head)
    Clock.now(Pipeline.clock(importer.pipeline)) - shift
  end

  @doc """
  Lets the clock, paused or not, jump to the next message of any stream of the store: `{:ok, time}` with its recorded
  time, or `{:ok, nil}` at the end.
  """
  @spec step(t()) :: {:ok, Situ.Time.t() | nil} | {:error, Error.t()}
  def step(%__MODULE__{} = importer) do
    clock = Pipeline.clock(importer.pipeline)
    {_version, _time, shift} = Playhead.view(importer.head)
    now = Clock.now(clock) - shift

    next =
      for info <- Reading.streams(importer.store),
          {:ok, %{originating_time: time}} <- [Reading.first_at(importer.store, info, now + 1)],
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
