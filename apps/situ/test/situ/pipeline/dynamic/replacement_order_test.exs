defmodule Situ.Pipeline.Dynamic.ReplacementOrderTest do
  # Replacements that are requested concurrently, or whose component dies before they are done.
  use ExUnit.Case, async: true

  import Situ.Test.Eventually

  alias Situ.Fixture.Count
  alias Situ.{Pipeline, Time}

  @moduletag :capture_log

  defmodule Slow do
    # Waits for permission at every message.
    use Situ.Component,
      inputs: [in: :any],
      outputs: [out: :any],
      options: [to: [type: :pid, required: true], k: [type: :integer, default: 0]]

    @impl true
    def init(opts), do: {:ok, {opts[:to], opts[:k]}}

    @impl true
    def handle_message(:in, m, _context, {to, k} = state) do
      send(to, {:at, self(), k})

      receive do
        :go -> {[{:out, m.originating_time, {k, m.data}}], state}
      end
    end

    @impl true
    def migrate({to, _k}, _old, new), do: {:ok, {to, new[:k]}}
  end

  defp slow(opts \\ []) do
    me = self()

    {:ok, p} =
      Pipeline.start(fn p ->
        p
        |> Situ.source(Count, count: :infinity, interval: Time.ms(1))
        |> Situ.via(Slow, [to: me, name: "Slow"] ++ opts)
        |> Situ.map(& &1, name: "Map", async: true)
        |> Situ.each(&send(me, {:out, &1}))
      end)

    assert_receive {:at, pid, 0}
    {p, pid}
  end

  # Releases messages until the component reports that it has become `k`.
  defp until(k) do
    receive do
      {:at, _pid, ^k} ->
        :ok

      {:at, pid, _} ->
        send(pid, :go)
        until(k)
    after
      5_000 -> flunk("never became #{k}")
    end
  end

  describe "replace/4" do
    test "several requests are handled one after another" do
      # The driver lets every message pass.
      driver = spawn_link(fn -> pass() end)

      {:ok, p} =
        Pipeline.start(fn p ->
          p
          |> Situ.source(Count, count: :infinity, interval: Time.ms(1))
          |> Situ.via(Slow, to: driver, name: "Slow")
        end)

      tasks =
        for k <- 1..5, do: Task.async(fn -> Pipeline.replace(p, "Slow", k: k, to: driver) end)

      assert Task.await_many(tasks, 30_000) == List.duplicate(:ok, 5)
      assert Pipeline.state(p) == :running
      Process.exit(p, :kill)
    end

    defp pass do
      receive do
        {:at, pid, _} ->
          send(pid, :go)
          pass()
      end
    end

    test "two operators of one chain can be replaced at the same time" do
      me = self()

      {:ok, p} =
        Pipeline.start(fn p ->
          p
          |> Situ.source(Count, count: :infinity, interval: Time.ms(1))
          |> Situ.map(& &1, name: "A")
          |> Situ.map(& &1, name: "B")
          |> Situ.each(&send(me, &1))
        end)

      tasks =
        for name <- ~w(A B A B),
            do: Task.async(fn -> Pipeline.replace(p, name, {:map, fn _ -> :new end}) end)

      assert Task.await_many(tasks) == [:ok, :ok, :ok, :ok]
      assert_receive :new
      assert {:ok, _} = Pipeline.stop(p)
    end

    test "returns an error if the component dies before it is replaced" do
      {p, pid} = slow(on_error: :restart)
      me = self()
      tasks = for k <- 1..3, do: Task.async(fn -> Pipeline.replace(p, "Slow", k: k, to: me) end)
      tap = Task.async(fn -> Situ.attach_tap({p, "Slow"}, fn _ -> :ok end) end)
      assert eventually(fn -> length(Pipeline.list_changes(p)) == 4 end)
      Process.exit(pid, :kill)

      for task <- [tap | tasks],
          do: assert({:error, %{code: :component_restarted}} = Task.await(task))

      assert_receive {:at, again, 0} when again != pid
      assert Pipeline.state(p) == :running
      Process.exit(p, :kill)
    end

    test "stops waiting after its timeout" do
      {p, pid} = slow()

      assert {:error, %{code: :timeout}} =
               Pipeline.replace(p, "Slow", [k: 7, to: self()], timeout: 20)

      send(pid, :go)
      # The replacement happens anyway.
      until(7)
      Process.exit(p, :kill)
    end
  end
end
