defmodule Situ.Pipeline.Dynamic.ChangesTest do
  # Changes to a running pipeline that coincide with its end or with each other.
  use ExUnit.Case, async: true
  import Situ.Test.Eventually

  alias Situ.{Pipeline, Time}
  alias Situ.Fixture.{Closing, Count}

  @moduletag :capture_log

  defp start(build), do: Pipeline.start(build, pipeline: [stop_timeout: 30_000])

  defp numbers(p),
    do: Situ.source(p, Count, count: :infinity, interval: Time.ms(1), name: "Count")

  defp stand_still(me, as),
    do: fn _ ->
      if Process.put(:stood, true) == nil do
        send(me, {as, self()})
        receive do: (:go -> :ok)
      end
    end

  # A consumer that blocks does not hold up the source.
  defp lossy, do: [async: true, policy: Situ.Delivery.latest()]

  defp stage_ids(p), do: Map.keys(:sys.get_state(p).stages)
  defp paths(p), do: Enum.map(Pipeline.info(p).nodes, & &1.path)

  defp extend(p, name, fun) do
    Pipeline.extend(p, fn p ->
      Situ.composite(Pipeline.stream(p, "Count"), name, fun)
      :ok
    end)
  end

  test "a tap can be detached while the outputs of its pipeline close" do
    me = self()

    {:ok, p} = start(fn p -> p |> numbers() |> Situ.each(stand_still(me, :slow), lossy()) end)

    assert_receive {:slow, slow}
    {:ok, tap} = Situ.attach_tap({p, "Count"}, stand_still(me, :tap))
    assert_receive {:tap, _}
    stop = Task.async(fn -> Pipeline.stop(p) end)
    assert eventually(fn -> :sys.get_state(p).life.step == :close end)
    # The closing mark has not reached the tap, which is still handling its first message.
    assert :ok = Situ.detach_tap(tap)
    assert Pipeline.state(p) == :stopping
    send(slow, :go)
    assert {:ok, %{errors: []}} = Task.await(stop, 30_000)
  end

  test "a tap's owner can die while the outputs of its pipeline close" do
    me = self()

    {:ok, p} = start(fn p -> p |> numbers() |> Situ.each(stand_still(me, :slow), lossy()) end)

    assert_receive {:slow, slow}
    fun = stand_still(me, :tap)

    owner = spawn(fn -> Situ.attach_tap({p, "Count"}, fun) && receive do: (:end -> :ok) end)

    assert_receive {:tap, _}
    stop = Task.async(fn -> Pipeline.stop(p) end)
    assert eventually(fn -> :sys.get_state(p).life.step == :close end)
    send(owner, :end)
    assert eventually(fn -> :sys.get_state(p).dynamic.taps == %{} end)
    send(slow, :go)
    assert {:ok, %{errors: []}} = Task.await(stop, 30_000)
  end

  test "a tap can be removed by name and then detached" do
    {:ok, p} = start(&numbers/1)
    me = self()
    {:ok, tap} = Situ.attach_tap({p, "Count"}, &send(me, {:seen, &1.data}), name: "Look")
    assert_receive {:seen, _}
    assert :ok = Pipeline.remove(p, "Look")
    assert :ok = Situ.detach_tap(tap)
    assert {:ok, _} = Situ.attach_tap({p, "Count"}, fn _ -> :ok end, name: "Look")
    assert "Look" in paths(p)
    assert {:ok, %{errors: []}} = Pipeline.stop(p)
  end

  describe "remove/3" do
    test "removes a stopped part and frees its name" do
      {:ok, p} = start(&numbers/1)
      [main] = stage_ids(p)

      for _ <- 1..3 do
        assert {:ok, :ok} = extend(p, "Side", &Situ.each(&1, fn _ -> :ok end, async: true))
        assert :ok = Pipeline.stop_part(p, "Side")
        assert {:error, %{code: :not_running}} = Pipeline.stop_part(p, "Side")
        assert :ok = Pipeline.remove(p, "Side")
        assert {:error, %{code: :unknown_component}} = Pipeline.remove(p, "Side")
        assert paths(p) == ["Count"]
      end

      assert eventually(fn -> stage_ids(p) == [main] end)
      assert :sys.get_state(p).life.links.topology == %{}
      assert {:ok, %{errors: []}} = Pipeline.stop(p)
    end

    test "removes a part completely even if one of its components was stopped before" do
      {:ok, p} = start(&numbers/1)

      assert {:ok, :ok} =
               extend(p, "Side", fn s ->
                 s
                 |> Situ.map(& &1, async: true, name: "A")
                 |> Situ.each(& &1, async: true, name: "B")
               end)

      assert :ok = Pipeline.stop_part(p, "Side.B")
      assert :ok = Pipeline.remove(p, "Side")
      assert paths(p) == ["Count"]
      assert {:ok, :ok} = extend(p, "Side", &Situ.each(&1, fn _ -> :ok end, name: "B"))
      assert {:ok, %{errors: []}} = Pipeline.stop(p)
    end

    test "removes a part that another process is stopping" do
      me = self()
      {:ok, p} = start(&numbers/1)
      assert {:ok, :ok} = extend(p, "Side", &Situ.each(&1, stand_still(me, :side), async: true))
      assert_receive {:side, side}
      stop = Task.async(fn -> Pipeline.stop_part(p, "Side") end)
      assert eventually(fn -> map_size(:sys.get_state(p).life.parts) == 1 end)
      removals = for _ <- 1..2, do: Task.async(fn -> Pipeline.remove(p, "Side") end)
      assert eventually(fn -> length(Pipeline.list_changes(p)) == 4 end)

      assert [:waiting, :waiting, :running, :applied] =
               for(change <- Pipeline.list_changes(p), do: change.state)

      send(side, :go)
      assert :ok = Task.await(stop, 30_000)
      # The second one waits for the first one, after which there is nothing to remove.
      answers = Task.await_many(removals, 30_000)
      assert [:ok, {:error, %{code: :unknown_component}}] = Enum.sort(answers)
      assert paths(p) == ["Count"]
      assert {:ok, %{errors: []}} = Pipeline.stop(p)
    end

    test "removes a composite that failed and closed by itself" do
      {:ok, p} = start(&numbers/1)

      assert {:ok, :ok} =
               Pipeline.extend(p, fn p ->
                 Situ.composite(
                   Pipeline.stream(p, "Count"),
                   "Side",
                   &Situ.each(&1, fn _ -> raise "as asked" end),
                   on_error: :close
                 )

                 :ok
               end)

      assert eventually(fn ->
               Enum.any?(
                 Pipeline.info(p).nodes,
                 &(&1.path == "Side.Each" and &1.state != :running)
               )
             end)

      assert :ok = Pipeline.remove(p, "Side")
      assert paths(p) == ["Count"]
      assert {:ok, _} = Pipeline.stop(p)
    end

    test "a consumer outside the part sees the end of its stream and is closed" do
      me = self()
      {:ok, p} = start(&numbers/1)

      {:ok, _} =
        Pipeline.extend(p, fn p ->
          Pipeline.stream(p, "Count")
          |> Situ.composite("Side", &Situ.map(&1, fn v -> v end, async: true))
          |> Situ.via(Closing, to: me, name: "Outside")

          :ok
        end)

      assert :ok = Pipeline.remove(p, "Side")
      assert_receive {:closed, :in, _}

      assert eventually(fn ->
               [outside] = for(%{path: "Outside"} = n <- Pipeline.info(p).nodes, do: n)
               outside.state == :closed
             end)

      assert eventually(fn -> length(stage_ids(p)) == 2 end)
      assert {:ok, %{errors: []}} = Pipeline.stop(p)
    end
  end

  test "two components of an extension that refuse to start do not end the pipeline" do
    {:ok, p} = start(&numbers/1)

    assert {:error, %{code: :refused}} =
             extend(p, "Side", fn s ->
               Situ.via(s, Situ.Pipeline.Dynamic.ChangesTest.Refusing, name: "A")
               Situ.via(s, Situ.Pipeline.Dynamic.ChangesTest.Refusing, name: "B")
             end)

    assert eventually(fn -> length(stage_ids(p)) == 1 end)
    assert Pipeline.state(p) == :running
    assert {:ok, %{errors: []}} = Pipeline.stop(p)
  end

  defmodule Refusing do
    use Situ.Component, inputs: [in: :any]
    @impl true
    def init(_opts), do: {:error, Situ.Error.new(:refused, "no")}
  end

  test "an invalid request returns an error to its caller only" do
    {:ok, p} = start(&numbers/1)
    assert Pipeline.clock(p)

    for request <- [{:replace, :all}, {:stop_part, 5, %{}}, {:tap, nil}],
        do: assert({:error, %{code: :request_failed}} = GenServer.call(p, request, 60_000))

    assert Pipeline.state(p) == :running
    assert {:ok, %{errors: []}} = Pipeline.stop(p)
  end
end
