defmodule Situ.Bench.Counters do
  @moduledoc false
  # The cost of connection counters: each chain runs unchanged, and in alternation with counters
  # that do nothing. CPU time is compared, since a busy machine affects the wall clock first.
  # `one` passes one message at a time, which is the worst case for counting.
  import Situ.Bench, only: [cpu_us: 0]
  alias Situ.{Delivery, Pipeline, Time}
  alias Situ.Ports.Counters

  @rounds 5

  # Creating and reading counters still work; only the functions on the hot path do nothing.
  @nothing """
  defmodule Situ.Ports.Counters do
    def new, do: :atomics.new(1, signed: true)
    def emitted(_ref, _n, _created, _posted), do: :ok
    def processed(_ref, _n, _latency, _busy), do: :ok
    def reached(_ref, _time), do: :ok
    def dropped(_ref, _n), do: :ok
    def waiting(_ref, _flag), do: :ok
    def sized(_ref, _messages), do: :ok
    def last_time(_ref), do: 0
    def flow(_ref), do: {0, 0, 0}
    def totals(_ref), do: Map.new(~w(emitted processed dropped created posted latency busy queue size sized)a, &{&1, 0})
    def read(_ref, totals), do: Map.take(totals, [:emitted, :processed, :dropped, :busy])
  end
  """

  def tests, do: [{"counters", &counters/1}]

  defp counters(scale) do
    for {name, k, n, opts} <- [
          {"chain10", 10, 400_000, []},
          {"chain10_async", 10, 100_000, [async: true]},
          {"one", 3, 40_000, [async: true, policy: Delivery.throttle(1)]}
        ],
        metric <- compare("counters_" <> name, k, max(round(n * scale), 1), opts),
        do: metric
  end

  # The two variants alternate, so that other load on the machine affects both alike.
  defp compare(metric, k, n, opts) do
    rounds =
      for _ <- 1..@rounds do
        {_, _} = counting(:on)
        on = cpu(k, n, opts)
        {_, _} = counting(:off)
        off = cpu(k, n, opts)
        counting(:on)
        {on, off}
      end

    on = rounds |> Enum.map(&elem(&1, 0)) |> Enum.sum()
    off = rounds |> Enum.map(&elem(&1, 1)) |> Enum.sum()

    [
      {metric <> "_cpu", on / (n * @rounds), "us/msg"},
      {metric <> "_off_cpu", off / (n * @rounds), "us/msg"},
      {metric <> "_cost", (on / off - 1) * 100, "percent"}
    ]
  end

  defp cpu(k, n, opts) do
    :erlang.garbage_collect()
    before = cpu_us()

    {:ok, _} =
      Pipeline.run(fn p ->
        1..k
        |> Enum.reduce(Situ.from_enumerable(p, 0..(n - 1)//1, every: Time.ticks(1)), fn _,
                                                                                        stream ->
          Situ.map(stream, &(&1 + 1), opts)
        end)
        |> Situ.each(& &1)
      end)

    max(cpu_us() - before, 1)
  end

  # The test replaces the module itself. The runtime needs no switch for it, which would affect
  # the measurement.
  defp counting(which) do
    {:ok, binary, path} = beam(which)
    :code.purge(Counters)
    {:module, Counters} = :code.load_binary(Counters, path, binary)
    {which, path}
  end

  defp beam(:on) do
    {Counters, binary, path} = kept(:on, fn -> :code.get_object_code(Counters) end)
    {:ok, binary, path}
  end

  defp beam(:off) do
    [{Counters, binary}] = kept(:off, fn -> compile() end)
    {:ok, binary, 'counters_off'}
  end

  defp compile do
    Code.put_compiler_option(:ignore_module_conflict, true)
    Code.compile_string(@nothing)
  end

  defp kept(which, make) do
    key = {__MODULE__, which}

    with nil <- :persistent_term.get(key, nil) do
      made = make.()
      :persistent_term.put(key, made)
      made
    end
  end
end
