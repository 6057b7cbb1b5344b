defmodule Situ.Bench do
  @moduledoc """
  Measures times and memory, for the tests in `bench/tests/`.
  """

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

  @doc "Runs `fun`, and returns its CPU time in microseconds divided by `n`, as `metric_cpu`."
  def measure_cpu(metric, n, unit, fun) do
    :erlang.garbage_collect()
    before = cpu_us()
    fun.()
    {metric <> "_cpu", (cpu_us() - before) / max(n, 1), unit}
  end

  @doc """
  Returns the user and system CPU time so far of this VM, or of the process with the given id, in
  microseconds, as counted by the kernel.

  `:erlang.statistics(:runtime)` counts user time only (OTP 25), without writes, page faults and
  wake-ups.
  """
  def cpu_us(pid \\ "self") do
    # Nanoseconds of each thread. A kernel without schedstat counts ticks of 10 ms for the entire
    # process.
    case Path.wildcard("/proc/#{pid}/task/*/schedstat") do
      [] -> ticks_us(File.read!("/proc/#{pid}/stat"))
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

  @doc "Returns the sizes that a test with this scale measures: the first, and others up to `scale` times the last."
  def sizes([first | rest], scale),
    do: [first | Enum.filter(rest, &(&1 <= List.last([first | rest]) * scale))]

  @doc "Returns the value of a sorted list below which the share `q` of its values is."
  def quantile(sorted, q),
    do: Enum.at(sorted, min(floor(length(sorted) * q), length(sorted) - 1))

  @doc """
  Calls a function of a module in the test `file` in a new VM, and returns its result. The VM has
  the flags of this VM and the given ones. Memory and caches of earlier measurements do not
  affect it.
  """
  def call_in_new_vm(file, {module, function, args}, flags \\ []) do
    paths = Enum.flat_map(:code.get_path(), &[~c"-pa", &1])

    {:ok, peer, _} =
      :peer.start_link(%{
        connection: :standard_io,
        args: paths ++ Enum.map(vm_flags() ++ flags, &to_charlist/1),
        wait_boot: 60_000
      })

    try do
      for app <- [:elixir, :situ_store],
          do: {:ok, _} = :peer.call(peer, :application, :ensure_all_started, [app], 60_000)

      for file <- [__ENV__.file, file], do: :peer.call(peer, Code, :require_file, [file], 60_000)
      :peer.call(peer, module, function, args, :infinity)
    after
      :peer.stop(peer)
    end
  end

  @doc "Returns the flags with which bin/bench starts a VM."
  def vm_flags do
    extra = String.split(System.get_env("SITU_BENCH_FLAGS", ""))
    if System.get_env("SITU_BENCH_VM") == "plain", do: extra, else: release_flags() ++ extra
  end

  defp release_flags do
    text = File.read!(Path.expand("../rel/vm.args.eex", __DIR__))
    for "+" <> _ = line <- String.split(text, "\n"), word <- String.split(line), do: word
  end

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
end
