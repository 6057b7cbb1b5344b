defmodule Situ.Pipeline.DynamicTest do
  # Changes a running pipeline under full load in every possible way, concurrently and at random.
  use ExUnit.Case, async: true

  alias Situ.Pipeline

  @moduletag :capture_log

  defmodule Endless do
    use Situ.Component, outputs: [out: :integer]

    @impl true
    def init(_opts), do: {:ok, 0}

    @impl true
    def handle_start(_context, n), do: {[{:complete, :infinity}], n}

    @impl true
    def handle_demand(n, _context, next),
      do: {for(i <- next..(next + n - 1), do: {:out, i * 10, i}), next + n}
  end

  defmodule Work do
    use Situ.Component,
      inputs: [in: :any],
      outputs: [out: :any],
      options: [k: [type: :integer, default: 0]]

    @impl true
    def init(opts), do: {:ok, opts[:k]}

    @impl true
    def handle_message(:in, m, _context, k), do: {[{:out, m.originating_time, m.data}], k}

    @impl true
    def migrate(_state, _old, new), do: {:ok, new[:k]}
  end

  test "random calls under load all succeed, and no message is lost" do
    me = self()

    {:ok, p} =
      Pipeline.start(
        fn p ->
          p
          |> Situ.source(Endless)
          |> Situ.via(Work, name: "Work", on_error: :restart)
          |> Situ.map(& &1, name: "Map", async: true)
          |> Situ.scan(-1, &in_order/2, name: "Scan", async: true)
          |> Situ.each(&send(me, {:last, &1}),
            name: "Each",
            async: true,
            policy: Situ.Delivery.latest()
          )
        end,
        pipeline: [replay: [interval: {0, :unbounded}, speed: :max]]
      )

    assert_receive {:last, _}

    calls =
      for n <- 1..(100 * Situ.Test.Budget.repeat_factor()),
          do: Task.async(fn -> call(:rand.uniform(6), p, n) end)

    assert Enum.all?(Task.await_many(calls, 60_000), &(&1 == :ok))
    assert {:ok, %{errors: []}} = Pipeline.stop(p, catch_up: 0)
  end

  # Raises if a message is missing or arrives twice.
  defp in_order(n, last) when n == last + 1, do: n

  defp call(1, p, n), do: Pipeline.replace(p, "Work", k: n)
  defp call(2, p, _n), do: Pipeline.replace(p, "Map", {:map, & &1})

  defp call(3, p, _n) do
    with {:ok, tap} <- Situ.attach_tap({p, "Work"}, fn _ -> :ok end), do: Situ.detach_tap(tap)
  end

  defp call(4, p, n) do
    with {:ok, _} <-
           Pipeline.extend(p, fn p ->
             p |> Pipeline.stream("Work") |> Situ.each(fn _ -> :ok end, name: "More#{n}")
           end),
         do: Pipeline.remove(p, "More#{n}")
  end

  defp call(5, p, _n), do: if(%{state: :running} = Pipeline.info(p), do: :ok)
  defp call(6, p, _n), do: if(is_float(Pipeline.progress(p)), do: :ok)
end
