defmodule Situ.Store.Importer do
  @moduledoc """
  A store being replayed by a pipeline: what `Situ.Store.importer/3` returns and `Situ.Store.stream/3` takes.

  All importers of a pipeline run on its clock: an interval and a speed are the pipeline's (`pipeline: [replay: [interval: {from, to}, speed: 4.0]]`),
  `Situ.Pipeline.pause/1`, `resume/1` and `set_speed/2` act on all of them. `seek/2` and `step/1` go forward.
  """
  alias Situ.{Clock, Error, Pipeline}
  alias Situ.Store
  alias Situ.Store.{Evolution, Source}

  @options [
    loop: [
      type: {:or, [:boolean, :pos_integer]},
      default: false,
      doc:
        "Start over at the end, times shifted by the store's span and 1 ms, or by this period (ns)."
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

  @enforce_keys [:store, :pipeline, :skip]
  defstruct [:store, :pipeline, :skip, :period, skip_damage: false]
  @type t :: %__MODULE__{}

  @nowhere -0x7FFFFFFFFFFFFFFF

  @doc false
  def options, do: @options
  @doc false
  def stream_options, do: @stream_options

  @doc false
  def open(%Pipeline{} = p, path, opts) do
    opts = Situ.Options.validate!(opts, @options)
    store = if is_struct(path, Store), do: path, else: Store.open!(path, verify: opts[:verify])
    skip = :atomics.new(1, signed: true)
    :atomics.put(skip, 1, @nowhere)

    %__MODULE__{
      store: store,
      pipeline: p,
      skip: skip,
      period: period(store, opts[:loop]),
      skip_damage: opts[:skip_damage]
    }
  end

  defp period(_store, false), do: nil
  defp period(_store, ns) when is_integer(ns), do: ns

  defp period(store, true) do
    case Store.interval(store) do
      nil -> nil
      {first, last} -> last - first + 1_000_000
    end
  end

  @doc false
  def stream(%__MODULE__{} = importer, name, opts) do
    opts = Situ.Options.validate!(opts, @stream_options)

    case Store.stream_info(importer.store, name) do
      {:ok, info} -> source(importer, info, opts)
      {:error, error} -> if opts[:or_empty], do: empty(importer, name, opts), else: raise(error)
    end
  end

  defp source(importer, info, opts) do
    type = opts[:type]
    if type, do: check!(info, type)
    live? = Store.live?(importer.store)

    last = if importer.period, do: :unbounded, else: info.last

    if info.first && not live?,
      do: Pipeline.propose_replay(importer.pipeline, {info.first, last})

    add(importer, info, [importer: importer, info: info, type: type, live: live?], opts)
  end

  defp empty(importer, name, opts) do
    info = %Store.StreamInfo{id: -1, name: name}
    add(importer, info, [importer: importer, info: info, type: nil, live: false], opts)
  end

  defp add(importer, info, source_opts, opts) do
    name = opts[:name] || String.replace(info.name, ".", " ")
    outputs = [out: opts[:type] || info.type]
    named(importer.pipeline, source_opts, outputs, name, if(opts[:name], do: nil, else: 2))
  end

  # Streams of several stores often have the same name: the later ones get a number.
  defp named(p, source_opts, outputs, name, next) do
    Situ.source(p, Source, source_opts, name: name, outputs: outputs)
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
  Goes on at `time`: what lies before it is left out, and the pipeline's clock jumps there. Forward only, since originating times increase; a few
  messages per stream that were already handed to the pipeline still come.
  """
  @spec seek(t(), Situ.Time.t()) :: :ok | {:error, Error.t()}
  def seek(%__MODULE__{} = importer, time) do
    clock = Pipeline.clock(importer.pipeline)

    if time < Clock.now(clock) do
      {:error,
       Error.new(:cannot_go_back, "a running pipeline cannot go back in time",
         why: "originating times of a stream only increase",
         fix: "start it anew with `replay: [interval: {time, :unbounded}]`"
       )}
    else
      :atomics.put(importer.skip, 1, time)
      Clock.jump(clock, time)
    end
  end

  @doc "Lets the clock, paused or not, jump to the next message of any stream of the store: `{:ok, time}`, or `{:ok, nil}` at the end."
  @spec step(t()) :: {:ok, Situ.Time.t() | nil} | {:error, Error.t()}
  def step(%__MODULE__{} = importer) do
    clock = Pipeline.clock(importer.pipeline)
    now = Clock.now(clock)

    next =
      for info <- Store.streams(importer.store),
          {:ok, %{originating_time: time}} <- [Store.first_at(importer.store, info, now + 1)],
          do: time

    case next do
      [] -> {:ok, nil}
      times -> with :ok <- Clock.jump(clock, Enum.min(times)), do: {:ok, Enum.min(times)}
    end
  end
end
