Code.require_file("latency.exs", __DIR__)

defmodule Situ.Bench.PythonComponent do
  @moduledoc false
  # A component in Python that returns its input: the round trip at 1,000 messages per second, numbers as fast as
  # possible, and images of 1920 x 1080 RGB there and back at 200 per second. `python-component-peers` measures the same
  # with pyzmq, ezmsg and dora (`SITU_BENCH_PYTHON` with these packages; otherwise it is skipped).
  alias Situ.Bench.Latency.Metronome
  alias Situ.Pipeline

  @echo """
  import numpy, situ
  class Echo(situ.Component):
      def on_message(self, value, message):
          return {"out": value}
  class Brighten(situ.Component):
      def on_image(self, image, message):
          return {"out": image.array + 1}
  class Fill(situ.Component):
      def on_image(self, image, message):
          result = self.empty(image.array.shape, image.array.dtype)
          numpy.add(image.array, 1, out=result)
          return {"out": result}
  """

  defmodule Camera do
    @moduledoc false
    use Situ.Component,
      outputs: [out: Situ.Image],
      options: [count: [type: :pos_integer, required: true]]

    @impl true
    def init(opts) do
      {width, height} = {1920, 1080}
      data = :binary.copy(<<1, 2, 3>>, width * height)
      {:ok, image} = Situ.Image.new(width: width, height: height, format: :rgb24, data: data)
      {:ok, %{left: opts[:count], timer: nil, image: image}}
    end

    @impl true
    def handle_start(_context, state) do
      {:ok, timer} = :timer.send_interval(5, :tick)
      {[], %{state | timer: timer}}
    end

    @impl true
    def handle_info(:tick, context, %{left: left} = state) when left > 0 do
      rest = if left == 1, do: [{:complete, context.now}], else: []
      {[{:out, context.now, state.image} | rest], %{state | left: left - 1}}
    end

    def handle_info(_other, _context, state), do: {[], state}
  end

  def tests do
    [
      {"python-component-latency", &latency(max(100, round(3_000 * &1)))},
      {"python-component-numbers", &numbers(max(1_000, round(300_000 * &1)))},
      {"python-component-images", &images("Brighten", max(20, round(1_000 * &1)))},
      {"python-component-images-in-place", &images("Fill", max(20, round(1_000 * &1)))},
      {"python-component-images-unchanged", &images("Echo", max(20, round(1_000 * &1)))},
      {"python-component-peers", &peers/1}
    ]
  end

  defp latency(n) do
    me = self()

    {:ok, _} =
      Pipeline.run(fn p ->
        p
        |> Situ.source(Metronome, count: n)
        |> component("Echo", out: [out: :integer])
        |> Situ.each(&send(me, {:took, :erlang.monotonic_time() - &1}))
      end)

    times = for _ <- 1..n, do: receive(do: ({:took, t} -> t / 1_000))
    # Messages wait while Python starts.
    sorted = times |> Enum.drop(div(n, 3)) |> Enum.sort()

    for {name, share} <- [p50: 0.5, p99: 0.99],
        do: {"python_component_latency_#{name}", Situ.Bench.quantile(sorted, share), "us"}
  end

  defp numbers(n) do
    Situ.Bench.measure("python_component_numbers", n, fn ->
      {:ok, _} =
        Pipeline.run(fn p ->
          p
          |> Situ.from_enumerable(Stream.map(1..n, &(&1 / 1)), every: 1_000)
          |> component("Echo", out: [out: :float])
          |> Situ.each(fn _ -> :ok end)
        end)
    end)
  end

  # CPU time of both processes in percent of one core, from the first image to the last.
  defp images(class, n) do
    {:ok, agent} = Agent.start_link(fn -> nil end)

    {:ok, _} =
      Pipeline.run(fn p ->
        p
        |> Situ.source(Camera, count: n)
        |> component(class, out: [out: Situ.Image])
        |> Situ.scan(0, fn image, count ->
          sample(agent, count + 1, n)
          6_220_800 = byte_size(image.data)
          count + 1
        end)
        |> Situ.each(fn _ -> :ok end)
      end)

    name = "python_component_images_#{String.downcase(class)}"

    for {metric, value} <- Agent.get(agent, & &1), do: {"#{name}_#{metric}", value, "% of a core"}
  end

  defp sample(agent, count, n) when count == div(n, 10),
    do: Agent.update(agent, fn _ -> read() end)

  defp sample(agent, n, n) do
    Agent.update(agent, fn {wall, vm, python} ->
      {wall_now, vm_now, python_now} = read()
      share = &(100 * &1 / (wall_now - wall))
      [vm: share.(vm_now - vm), python: share.(python_now - python)]
    end)
  end

  defp sample(_agent, _count, _n), do: :ok

  defp read,
    do:
      {:erlang.monotonic_time(:microsecond), Situ.Bench.cpu_us(), Situ.Bench.cpu_us(worker_pid())}

  # The VM's only Python process.
  defp worker_pid do
    [pid | _] =
      for path <- Path.wildcard("/proc/[0-9]*/environ"),
          {:ok, text} <- [File.read(path)],
          String.contains?(text, "SITU_PYTHON_FOLDER"),
          pid = path |> Path.dirname() |> Path.basename(),
          {:ok, name} <- [File.read("/proc/#{pid}/comm")],
          String.starts_with?(name, "python"),
          do: pid

    pid
  end

  defp peers(scale) do
    for library <- ~w(zeromq ezmsg dora), {kind, n} <- [{"latency", 3_000}, {"images", 1_000}] do
      args = [library, kind, "#{max(20, round(n * scale))}"]
      bin = Path.dirname(System.get_env("SITU_BENCH_PYTHON") || "/usr/bin/python3")
      env = [{"EZMSG_LOGLEVEL", "ERROR"}, {"PATH", bin <> ":" <> System.get_env("PATH")}]
      name = "python_component_#{kind}_#{library}"

      case Situ.Bench.python("component.py", args, env: env) do
        {:ok, [p50, p99]} -> [{name <> "_p50", p50, "us"}, {name <> "_p99", p99, "us"}]
        {:ok, [share]} -> [{name, share, "% of a core"}]
        :error -> []
      end
    end
    |> Enum.concat()
  end

  defp component(stream, class, opts) do
    path = Path.join(System.tmp_dir!(), "situ-bench-echo-#{System.pid()}.py")
    File.write!(path, @echo)
    python = System.get_env("SITU_BENCH_PYTHON") || "/usr/bin/python3"
    Situ.Python.component(stream, "#{path}:#{class}", [python: python] ++ opts)
  end
end
