# Code as users of Situ write it, with their own specs. `bin/lib/dialyze` checks it together with Situ's apps: a spec
# of Situ that is narrower than its documentation shows up here as a type error in the user's project.
defmodule UserCode.Knocks do
  @moduledoc "A component."
  use Situ.Component,
    inputs: [in: :number],
    outputs: [out: :number, quiet: :boolean],
    options: [
      threshold: [type: :number, default: 0.6, doc: "The level of a knock."],
      quiet: [type: :time_ns, default: 200_000_000, doc: "The time between two knocks, ns."]
    ]

  defstruct [:threshold, :quiet, last: nil]
  @type t :: %__MODULE__{threshold: number(), quiet: pos_integer(), last: Situ.Time.t() | nil}

  @impl true
  @spec init(keyword()) :: {:ok, t()}
  def init(opts), do: {:ok, %__MODULE__{threshold: opts[:threshold], quiet: opts[:quiet]}}

  @impl true
  def handle_start(context, state), do: {[{:timer, :check, context.start_time}], state}

  @impl true
  def handle_message(:in, %Situ.Message{data: level, originating_time: time}, _context, state) do
    if level >= state.threshold and quiet?(state, time),
      do: {[{:out, time, level}], %{state | last: time}},
      else: {[], state}
  end

  @impl true
  def handle_info({:timer, :check}, context, state),
    do: {[{:quiet, context.now, quiet?(state, context.now)}], state}

  def handle_info(_other, _context, state), do: {[], state}

  @impl true
  def handle_request(:last, from, _context, state) do
    if from, do: GenServer.reply(from, state.last)
    {[], state}
  end

  @impl true
  def handle_closed(:in, _time, _context, state), do: {[{:close, :out}, {:linger, false}], state}

  @impl true
  def snapshot(state), do: {:ok, Map.from_struct(state)}

  @impl true
  def restore(data, fresh), do: {:ok, struct!(fresh, data)}

  @impl true
  def describe(state), do: "the last knock was at #{state.last}"

  @impl true
  def terminate(_reason, _state), do: :ok

  @spec quiet?(t(), Situ.Time.t()) :: boolean()
  defp quiet?(%{last: nil}, _time), do: true
  defp quiet?(%{last: last, quiet: quiet}, time), do: time - last >= quiet
end

defmodule UserCode.Camera do
  @moduledoc "A source that opens a device and may fail."
  use Situ.Component, inputs: [], outputs: [out: {:list, :integer}]

  @impl true
  def init(_opts) do
    if File.exists?("/dev/video0"),
      do: {:ok, 0},
      else: {:error, Situ.Error.new(:no_camera, "no camera", fix: "plug one in")}
  end

  @impl true
  def handle_demand(n, context, state),
    do: {for(i <- 1..n, do: {:out, context.now + i, [i]}), state + n}

  @impl true
  def handle_stop(_final, _context, state), do: {[], state}
end

defmodule UserCode.Door do
  @moduledoc "A state machine."
  @behaviour Situ.StateMachine

  @impl true
  def init(_opts), do: {:closed, %{opened: 0}}

  @impl true
  def handle_event(:closed, {:message, %{data: :push}}, data) do
    actions = [{:emit, :opened}, {:state_timeout, Situ.Time.s(3)}]
    {:next_state, :open, %{data | opened: data.opened + 1}, actions}
  end

  def handle_event(:open, :state_timeout, data), do: {:next_state, :closed, data}
  def handle_event(_state, _event, data), do: {:keep_state, data}
end

defmodule UserCode.Lobby do
  @moduledoc "A pipeline with most operators."
  use Situ.Pipeline,
    options: [threshold: [type: :number, default: 0.6, doc: "The level of a knock."]]

  alias Situ.{Available, Delivery, Interval, Pipeline, Reproducible, Store, Stream, Time}

  @impl true
  def build(p, opts) do
    store = Store.create(p, "lobby", "recordings", split: Time.h(1), keep: {:span, Time.h(24)})
    level = simulate_level(p)
    knocks = detect_knocks(level, opts)
    Store.write(level, store, "Level")
    knocks |> Store.write(store, "Knock") |> Situ.each(&print_knock/2, on_error: :skip)
    fuse_streams(level, knocks)
    compute_statistics(level)

    Pipeline.on(p, :completed, fn report ->
      IO.puts("#{report.name}: #{length(report.errors)}")
    end)

    Situ.composite(level, "Side", fn stream -> Situ.map(stream, &(&1 * 2)) end)
  end

  @spec simulate_level(Pipeline.t()) :: Stream.t()
  defp simulate_level(p) do
    p
    |> Situ.sequence(0, &(&1 + 1), every: Time.ms(20))
    |> Situ.map(&abs(:math.sin(&1 / 30)), type: :float, name: "Level")
  end

  @spec detect_knocks(Stream.t(), keyword()) :: Stream.t()
  defp detect_knocks(level, opts) do
    %{out: knocks} =
      Situ.via(level, UserCode.Knocks, threshold: opts[:threshold], policy: Delivery.latest())

    knocks
  end

  @spec fuse_streams(Stream.t(), Stream.t()) :: Stream.t()
  defp fuse_streams(level, knocks) do
    joined = Situ.join(level, knocks, Reproducible.nearest(Time.ms(60)))
    _ = Situ.join(level, knocks, Time.ms(5), name: "Near")
    _ = Situ.join(level, [knocks, joined], Available.last())
    _ = Situ.join([level, knocks])
    _ = Situ.pair(level, knocks)
    _ = Situ.zip([level, knocks])
    _ = Situ.merge(level, knocks)
    _ = Situ.sample(level, Time.ms(10), Reproducible.linear())
    _ = Situ.sample(level, knocks, Interval.infinite())

    joined
    |> Situ.map(fn {a, b}, message -> {a + b, message.originating_time} end)
    |> Situ.filter(fn {sum, _time} -> sum > 1 end)
    |> Situ.map_async(fn {sum, _time} -> round(sum) end, max: 4)
    |> Situ.scan(0, &(&1 + &2))
    |> Situ.state_machine(UserCode.Door)
    |> Situ.delay(Time.ms(5))
    |> Situ.reorder(Time.ms(5))
    |> Situ.first(10)
    |> Situ.name("Doors")
  end

  @spec compute_statistics(Stream.t()) :: [Stream.t()]
  defp compute_statistics(level) do
    [
      Situ.window(level, Interval.past(Time.s(1)), &Enum.sum/1),
      Situ.window(level, -2..0, &length/1),
      Situ.window(level, -2..0, with: :messages),
      Situ.average(level, window: Interval.past(Time.s(1))),
      Situ.max(level, window: -4..0),
      Situ.sum(level),
      Situ.count(level),
      Situ.lowpass(level, cutoff: 5.0, rate: 50.0),
      Situ.denoise(level),
      Situ.latency(level),
      Situ.process(level, 0, fn message, n ->
        {[{message.originating_time, message.data}], n + 1}
      end),
      Situ.parallel(Situ.map(level, &%{a: &1}), fn _key, branch -> Situ.map(branch, &(&1 + 1)) end)
    ]
  end

  defp print_knock(level, %Situ.Message{originating_time: time}),
    do: IO.puts("#{Time.to_iso8601(time)}  knock, level #{Float.round(level, 2)}")
end

defmodule UserCode.Tune do
  @moduledoc "An experiment."
  use Situ.Experiment
  alias Situ.{Experiment, Metric, Time}

  @impl true
  def parameters, do: [threshold: [0.5, 0.7], quiet: {:time_ns, [Time.ms(100), Time.ms(300)]}]

  @impl true
  def build(_p, session, %{threshold: threshold}) do
    %{level: level} = Experiment.cached(session, :read_level, stream: "Level")
    %{"Loud" => Situ.map(level, &(&1 > threshold))}
  end

  @spec read_level(term(), map()) :: %{level: Situ.Stream.t()}
  def read_level(session, %{stream: name}), do: %{level: Experiment.stream(session, name)}

  @impl true
  def metrics,
    do: [loud: Metric.intervals(truth: "Loud.Truth", main: :time_f1), cost: Metric.cost()]
end

defmodule UserCode.Loudness do
  @moduledoc "A task of the studio and the command line."
  @behaviour Situ.Dataset.Task

  @impl true
  def task do
    %{
      name: "loudness",
      about: "the loudness of an audio stream",
      output: "Loudness",
      options: [stream: [type: :string, default: "Audio", doc: "The audio stream."]]
    }
  end

  @impl true
  def build(_p, opts),
    do: opts[:stream] |> opts[:open].() |> Situ.map(& &1) |> opts[:write].("Loudness")
end

defmodule UserCode.Metrics do
  @moduledoc "Metrics of an application."
  @behaviour Situ.Metrics

  @impl true
  def collect_metrics do
    samples = [{[door: "main"], 3}, {[door: "side"], 0.5}]
    [%{name: "visitors_total", type: :counter, help: "Visitors so far.", samples: samples}]
  end
end

defmodule UserCode.Application do
  @moduledoc "Supervises a pipeline, a studio and metrics."
  use Application
  alias Situ.{Error, Pipeline, Store, Time}

  @impl true
  def start(_type, _args) do
    name = {:via, Registry, {UserCode.Registry, "lobby"}}

    children = [
      {Registry, keys: :unique, name: UserCode.Registry},
      {Pipeline, {UserCode.Lobby, threshold: 0.5, pipeline: [name: name]}},
      Supervisor.child_spec({Pipeline, {&build_clock/1, []}}, id: :clock, restart: :permanent),
      {DynamicSupervisor, name: UserCode.Pipelines},
      {Situ.Studio, path: "recordings", port: 4040, pipelines: ["lobby"]},
      {Situ.Metrics.Server, port: 9568}
    ]

    Supervisor.start_link(children, strategy: :one_for_one)
  end

  @spec build_clock(Pipeline.t()) :: Situ.Stream.t()
  def build_clock(p), do: p |> Situ.timer(every: Time.s(1)) |> Situ.each(&IO.puts/1)

  @spec start_pipeline(String.t()) :: DynamicSupervisor.on_start_child()
  def start_pipeline(name) do
    child = {Pipeline, {UserCode.Lobby, pipeline: [name: name]}}
    DynamicSupervisor.start_child(UserCode.Pipelines, child)
  end

  @spec run_file(Path.t()) :: {:ok, non_neg_integer()} | {:error, Error.t()}
  def run_file(path) do
    with {:ok, report} <-
           Pipeline.run(
             fn p ->
               p |> Store.importer(path) |> Store.stream("Level") |> Situ.each(&IO.puts/1)
             end,
             pipeline: [replay: [speed: :max]]
           ),
         do: {:ok, length(report.errors)}
  end

  @spec read_levels(Path.t()) :: {:ok, [number()]} | {:error, String.t()}
  def read_levels(path) do
    case Store.open(path) do
      {:ok, store} -> {:ok, for(message <- Store.messages(store, "Level"), do: message.data)}
      {:error, %Error{} = error} -> {:error, Exception.message(error)}
    end
  end

  @spec watch(pid()) :: {:ok, Situ.Diagnostics.Snapshot.t()} | {:error, atom()}
  def watch(pid) do
    case Pipeline.stop(pid) do
      {:ok, report} -> {:ok, report.snapshot}
      {:error, %Error{code: code}} -> {:error, code}
    end
  end

  @spec convert(binary()) :: {:ok, Situ.EncodedImage.t()} | {:error, Error.t()}
  def convert(bytes) do
    with {:ok, image} <- Situ.Image.new(width: 2, height: 2, format: :gray8, data: bytes),
         do: Situ.ImageOps.encode_jpeg(image, quality: 80)
  end
end
