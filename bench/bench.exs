# The benchmark runner: `bin/bench TEST [REPS] [SCALE]`. bench/README.md describes its output.
defmodule Situ.Bench do
  @moduledoc """
  Runs one benchmark and prints `name,value,unit` lines on standard output.

  A benchmark is a module in `bench/tests/` with `tests/0 :: [{name, fun}]`. `fun.(scale)` runs
  one repetition and returns `[{metric, value, unit}]`. It raises if its own counts or sums are
  wrong.
  """

  @quick ~w(empty chain-1-unlimited chain-10-unlimited join-exact-unlimited zip-unlimited storeint-unlimited seek)

  @doc """
  Runs `fun`, which handles `n` messages. Returns its rate by the wall clock as `metric`, and the
  CPU time of the VM per message (user and system, in microseconds) as `metric_cpu`. `fun` may
  return extra metrics.
  """
  def measure(metric, n, unit \\ "msg/s", fun) do
    :erlang.garbage_collect()
    cpu = cpu_us()
    started = :erlang.monotonic_time(:nanosecond)
    extra = fun.()
    wall = :erlang.monotonic_time(:nanosecond) - started
    used = cpu_us() - cpu

    [{metric, n * 1.0e9 / max(wall, 1), unit}, {metric <> "_cpu", used / max(n, 1), "us/msg"}] ++
      if(is_list(extra), do: extra, else: [])
  end

  @doc """
  Returns the user and system CPU time of this VM so far in microseconds, as counted by the
  kernel.

  `:erlang.statistics(:runtime)` counts user time only (OTP 25), without writes, page faults and
  wake-ups.
  """
  def cpu_us do
    # Nanoseconds of each thread. A kernel without schedstat counts ticks of 10 ms for the entire
    # process.
    case Path.wildcard("/proc/self/task/*/schedstat") do
      [] -> ticks_us(File.read!("/proc/self/stat"))
      files -> files |> Enum.map(&thread_ns/1) |> Enum.sum() |> div(1_000)
    end
  end

  # A thread may end after it was listed.
  defp thread_ns(file) do
    with {:ok, text} <- File.read(file),
         {ns, _} <- Integer.parse(text) do
      ns
    else
      _ -> 0
    end
  end

  # Fields 14 (user) and 15 (system), counted after the closing parenthesis of the command.
  defp ticks_us(stat) do
    fields = stat |> String.split(") ") |> List.last() |> String.split()

    fields
    |> Enum.slice(11, 2)
    |> Enum.map(&String.to_integer/1)
    |> Enum.sum()
    |> Kernel.*(10_000)
  end

  @doc "Returns the VM's peak resident memory in MiB."
  def peak_rss_mib, do: status_mib("VmHWM")
  @doc "Returns the VM's current resident memory in MiB."
  def rss_mib, do: status_mib("VmRSS")

  @doc "Creates a folder for files of a benchmark, below `SITU_BENCH_DIR` if that is set."
  def folder! do
    root = System.get_env("SITU_BENCH_DIR") || System.tmp_dir!()
    path = Path.join(root, "situ-bench-#{System.pid()}-#{System.unique_integer([:positive])}")
    File.mkdir_p!(path)
    path
  end

  @doc "Returns a free port of this machine."
  def free_port do
    {:ok, socket} = :gen_tcp.listen(0, ip: {127, 0, 0, 1})
    {:ok, port} = :inet.port(socket)
    :gen_tcp.close(socket)
    port
  end

  @doc """
  Runs a script of `bench/python` and returns the numbers that it prints. Uses the given
  `:python`, the one in `SITU_BENCH_PYTHON`, or the packages that test/bridge has installed.
  Reports on standard error and returns `:error` if it fails.
  """
  def python(script, args, opts \\ []) do
    own = Path.expand("../_build/bridge-venv/bin/python", __DIR__)
    usual = if File.exists?(own), do: own, else: "python3"
    python = opts[:python] || System.get_env("SITU_BENCH_PYTHON") || usual
    path = Path.expand("python/#{script}", __DIR__)

    case System.cmd(python, [path | args], env: opts[:env] || [], stderr_to_stdout: true) do
      {out, 0} ->
        last = out |> String.split("\n", trim: true) |> List.last()
        {:ok, last |> String.split() |> Enum.map(&String.to_float/1)}

      {out, _} ->
        why = out |> String.trim() |> String.slice(-80, 80)
        IO.puts(:stderr, "#{script} #{Enum.join(args, " ")}: nothing is measured: #{why}")
        :error
    end
  rescue
    error in ErlangError ->
      IO.puts(:stderr, "#{script}: nothing is measured: #{Exception.message(error)}")
      :error
  end

  defp status_mib(field) do
    [_, kb] = Regex.run(~r/#{field}:\s+(\d+) kB/, File.read!("/proc/self/status"))
    String.to_integer(kb) / 1024
  end

  def main(["list"]), do: Enum.each(names(), &IO.puts/1)

  def main([name | rest]) do
    {reps, scale} = parse(rest)

    case select(name) do
      [] -> usage("no benchmark #{inspect(name)}#{hint(name)}")
      [one] -> run(one, reps, scale)
      many -> many |> Enum.reject(&spawn_vm(&1, reps, scale)) |> report_failed()
    end
  end

  def main(_), do: usage("which benchmark?")

  defp select("all"), do: names()
  defp select("quick"), do: Enum.filter(@quick, &(&1 in names()))
  defp select(name), do: if(name in names(), do: [name], else: [])

  defp hint(name) do
    case Situ.Options.nearest_name(name, names()) do
      nil -> ""
      near -> "; did you mean #{near}?"
    end
  end

  defp parse(rest) do
    with [reps | more] <- rest ++ List.duplicate(nil, 2 - min(2, length(rest))),
         [scale | _] <- more,
         {:ok, reps} <- number(reps || "5", &Integer.parse/1),
         {:ok, scale} <- number(add_leading_zero(scale || "1"), &Float.parse/1) do
      {reps, scale}
    else
      _ ->
        usage(
          "REPS must be a whole number above 0, and SCALE a number above 0, as in: chain 3 .5"
        )
    end
  end

  defp add_leading_zero("." <> _ = text), do: "0" <> text
  defp add_leading_zero(text), do: text

  defp number(text, parse) do
    case parse.(text) do
      {n, ""} when n > 0 -> {:ok, n}
      _ -> :error
    end
  end

  # Every test runs in a new VM, so that garbage and warm caches of one test do not affect
  # another. Returns whether the test succeeded.
  defp spawn_vm(name, reps, scale) do
    script = System.get_env("SITU_BENCH") || "bin/bench"
    args = [name, "#{reps}", "#{scale}"]
    {_, status} = System.cmd(script, args, into: IO.stream(:stdio, :line))
    status == 0
  end

  defp report_failed([]), do: :ok

  defp report_failed(names) do
    IO.puts(:stderr, "bench: #{length(names)} failed: #{Enum.join(names, " ")}")
    System.halt(1)
  end

  defp run(name, reps, scale) do
    {^name, fun} = List.keyfind(tests(), name, 0)
    IO.puts(:stderr, "#{name}: #{reps} repetitions at scale #{scale}")
    # The warm-up loads code and makes compiled paths hot. A tenth of the work is enough.
    fun.(scale / 10)

    1..reps
    |> Enum.flat_map(fn rep ->
      metrics = fun.(scale)
      IO.puts(:stderr, "  #{rep}: " <> Enum.map_join(metrics, "  ", &show/1))
      metrics
    end)
    |> Kernel.++([{name <> "_peak_rss", peak_rss_mib(), "MiB"}])
    |> report()
  catch
    kind, reason ->
      IO.puts(:stderr, Exception.format(kind, reason, __STACKTRACE__))
      IO.puts("failed_#{name},1,exit")
      System.halt(1)
  end

  defp show({metric, value, unit}), do: "#{metric}=#{format(value)} #{unit}"

  defp report(metrics) do
    order = metrics |> Enum.map(&elem(&1, 0)) |> Enum.uniq()
    by_name = Enum.group_by(metrics, &elem(&1, 0))

    for metric <- order do
      values = by_name[metric] |> Enum.map(&elem(&1, 1)) |> Enum.sort()
      unit = by_name[metric] |> hd() |> elem(2)
      IO.puts("#{metric},#{format(median(values))},#{unit}")

      if length(values) > 1 do
        IO.puts("#{metric}.min,#{format(hd(values))},#{unit}")
        IO.puts("#{metric}.max,#{format(List.last(values))},#{unit}")
      end
    end
  end

  defp median(sorted) do
    n = length(sorted)
    upper = Enum.at(sorted, div(n, 2))
    if rem(n, 2) == 1, do: upper, else: (upper + Enum.at(sorted, div(n, 2) - 1)) / 2
  end

  defp format(value) when is_integer(value), do: Integer.to_string(value)
  defp format(value) when abs(value) >= 100, do: :erlang.float_to_binary(value, decimals: 1)
  defp format(value), do: :erlang.float_to_binary(value * 1.0, decimals: 4)

  defp names, do: Enum.map(tests(), &elem(&1, 0))

  defp tests do
    for {module, _} <- :persistent_term.get(__MODULE__, []), test <- module.tests(), do: test
  end

  defp usage(problem) do
    IO.puts(:stderr, "bench: #{problem}\nUsage: bin/bench TEST|all|quick|list [REPS] [SCALE]")
    System.halt(2)
  end
end

tests = __DIR__ |> Path.join("tests/*.exs") |> Path.wildcard() |> Enum.sort()

modules =
  for file <- tests,
      {module, beam} <- Code.require_file(file) || [],
      function_exported?(module, :tests, 0),
      do: {module, byte_size(beam)}

:persistent_term.put(Situ.Bench, modules)
Situ.Bench.main(System.argv())
