defmodule Situ.Stage.ControlStressTest do
  use ExUnit.Case, async: true
  @moduletag :capture_log
  @moduletag timeout: 300_000

  alias Situ.Pipeline

  defmodule Work do
    use Situ.Component,
      inputs: [in: :any],
      outputs: [out: :any],
      options: [k: [type: :integer, default: 0]]

    @impl true
    def init(opts), do: {:ok, opts[:k]}
    @impl true
    def handle_message(:in, message, _context, k),
      do: {[{:out, message.originating_time, message.data + k}], k}

    @impl true
    def migrate(_state, _old, new), do: {:ok, new[:k]}
  end

  defp start do
    {:ok, p} =
      Pipeline.start(
        fn p ->
          p
          |> Situ.from_enumerable(Stream.iterate(0, &(&1 + 1)), every: 10)
          |> Situ.via(Work, name: "A", on_error: :restart)
          |> Situ.via(Work, name: "B", on_error: :restart)
          |> Situ.map(& &1, name: "C", async: true)
          |> Situ.each(fn _ -> :ok end, async: true)
        end,
        pipeline: [max_restarts: 1_000, replay: [interval: {0, :unbounded}, speed: :max]]
      )

    p
  end

  defp call(p, 0), do: Pipeline.replace(p, Enum.random(["A", "B"]), k: 1)
  defp call(p, 1), do: Pipeline.info(p) && :ok
  defp call(p, 2), do: {:ok, Pipeline.state(p)}
  defp call(p, 3), do: Situ.GenStage.subscription(p, Enum.random(["A", "B", "C"]))

  defp call(p, 4) do
    with {:ok, tap} <- Situ.attach_tap({p, Enum.random(["A", "B", "C"])}, fn _ -> :ok end),
         do: Situ.detach_tap(tap)
  end

  defp kill(p) do
    with {:ok, {pid, _}} <- Situ.GenStage.subscription(p, Enum.random(["A", "B"])),
         do: Process.exit(pid, :kill)
  end

  defp answers(p, calls) do
    1..8
    |> Enum.map(fn i ->
      Task.async(fn ->
        :rand.seed(:exsss, {i, ExUnit.configuration()[:seed], 3})
        for _ <- 1..calls, do: call(p, :rand.uniform(5) - 1)
      end)
    end)
    |> Task.await_many(240_000)
    |> List.flatten()
  end

  test "random requests under load all get a reply" do
    p = start()
    each = 25 * Situ.Test.Budget.repeat_factor()
    answers = answers(p, each)
    assert length(answers) == 8 * each
    assert Enum.all?(answers, &(&1 == :ok or match?({:ok, _}, &1)))
    Process.exit(p, :kill)
  end

  test "requests get a reply or an error even if components die" do
    p = start()
    me = self()

    killer =
      spawn_link(fn ->
        for _ <- 1..15 do
          receive do
            :stop -> exit(:normal)
          after
            50 -> kill(p)
          end
        end

        send(me, :killed)
      end)

    answers = answers(p, 20)
    assert length(answers) == 160

    codes =
      for answer <- answers, answer != :ok and not match?({:ok, _}, answer), uniq: true do
        assert {:error, %Situ.Error{code: code}} = answer
        code
      end

    assert :timeout not in codes
    send(killer, :stop)
    Process.exit(p, :kill)
  end
end
