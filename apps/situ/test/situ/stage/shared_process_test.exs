defmodule Situ.Stage.SharedProcessTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property

  alias Situ.{Delivery, Pipeline, Reproducible, Time}
  alias Situ.Stage.SharedProcess

  @moduletag :capture_log
  @settings [replay: [interval: {0, :unbounded}, speed: :max]]

  # Returns the process of each component.
  defp processes(p),
    do: Map.new(Supervisor.which_children(p), fn {path, pid, _, _} -> {path, pid} end)

  defp shared_processes(p) do
    for pid <- p |> processes() |> Map.values() |> Enum.uniq(),
        %SharedProcess{} = process <- [:sys.get_state(pid)],
        do: {pid, process}
  end

  # Starts a pipeline whose source waits at its item 20 until `resume/1`.
  defp start_waiting(build) do
    test = self()

    {:ok, p} =
      Pipeline.start(
        fn p ->
          p
          |> Situ.from_enumerable(Stream.map(0..499, &wait_at(&1, 20, test)),
            every: Time.ms(1),
            name: "Source"
          )
          |> build.()
        end,
        pipeline: @settings
      )

    p
  end

  defp wait_at(i, i, test) do
    send(test, {:waiting, self()})
    receive do: (:resume -> i)
  end

  defp wait_at(i, _other, _test), do: i

  defp resume do
    assert_receive {:waiting, source}, 10_000
    send(source, :resume)
  end

  describe "light stages" do
    test "share a process with their neighbors" do
      p =
        start_waiting(fn source ->
          left = Situ.map(source, &(&1 + 1), name: "Left")
          right = Situ.map(source, &(&1 * 2), name: "Right")
          [left, right] |> Situ.zip(name: "Zip") |> Situ.each(fn _ -> :ok end, name: "Sink")
        end)

      pids = processes(p)
      assert map_size(pids) == 5
      assert [_pid] = pids |> Map.values() |> Enum.uniq()
      resume()
      assert {:ok, _} = Pipeline.await(p)
    end

    test "keep separate processes where a policy drops messages, or with async: true" do
      p =
        start_waiting(fn source ->
          Situ.map(source, & &1, name: "Newest", policy: Delivery.latest())
          Situ.map(source, & &1, name: "Alone", async: true)
          Situ.map(source, & &1, name: "Near")
          Situ.map(source, & &1, name: "Throttled", policy: Delivery.throttle(1))
        end)

      pids = processes(p)
      assert pids["Near"] == pids["Source"]
      assert pids["Throttled"] == pids["Source"]
      assert pids["Newest"] not in [pids["Source"], pids["Alone"]]
      assert pids["Alone"] != pids["Source"]
      resume()
      assert {:ok, _} = Pipeline.await(p)
    end

    test "end one by one when their part is stopped" do
      test = self()

      p =
        start_waiting(fn source ->
          Situ.each(source, &send(test, {:first, &1}), name: "First")
          Situ.each(source, &send(test, {:second, &1}), name: "Second")
        end)

      resume()
      Pipeline.stop_part(p, "First")
      assert {:ok, _report} = Pipeline.await(p)
      first = received(:first)
      assert first == Enum.take(0..499, length(first))
      assert received(:second) == Enum.to_list(0..499)
    end

    test "fail the pipeline together when their process is killed" do
      p =
        start_waiting(fn source ->
          Situ.each(source, fn _ -> :ok end, name: "Sink", policy: Delivery.throttle(1))
          |> Situ.zip(source)
        end)

      Process.exit(processes(p)["Sink"], :kill)
      assert {:error, %{code: :component_killed}} = Pipeline.await(p)
    end
  end

  describe "a stage that leaves" do
    test "does so when it keeps others waiting, and loses nothing" do
      test = self()

      p =
        start_waiting(fn source ->
          Situ.each(source, &send(test, {:quick, &1}), name: "Quick")

          source
          |> Situ.map(
            fn i ->
              if i in 100..140, do: Process.sleep(2)
              i
            end,
            name: "Heavy"
          )
          |> Situ.each(&send(test, {:heavy, &1}), name: "Sink")
        end)

      assert processes(p)["Heavy"] == processes(p)["Quick"]
      resume()
      assert {:ok, report} = Pipeline.await(p)
      process = Map.new(report.snapshot.nodes, &{&1.path, &1.process})
      assert process["Heavy"] != process["Quick"]
      assert process["Source"] == process["Quick"]
      assert received(:quick) == Enum.to_list(0..499)
      assert received(:heavy) == Enum.to_list(0..499)
    end

    test "can be any of them, in any order" do
      for order <- [[1, 2, 3], [3, 2, 1], [2, 1, 3], [2, 3, 1]] do
        test = self()

        p =
          start_waiting(fn source ->
            left = Situ.map(source, &(&1 + 1), name: "Left")
            [left, source] |> Situ.zip(name: "Zip") |> Situ.each(&send(test, {:zipped, &1}))
          end)

        assert [pid] = p |> processes() |> Map.values() |> Enum.uniq()
        for id <- order, do: send(pid, {:situ, {:to, id, :relocate}})
        resume()
        assert {:ok, _} = Pipeline.await(p)
        assert received(:zipped) == for(i <- 0..499, do: [i + 1, i])
      end
    end

    property "changes no result, whichever leaves at whatever moment", numtests: 60 do
      forall moves <- list({integer(0, 5), integer(0, 60)}, 8) do
        test = self()

        {:ok, p} =
          Pipeline.start(
            fn p ->
              source = Situ.from_enumerable(p, 1..2_000, every: Time.ms(1), name: "Source")
              left = Situ.map(source, &(&1 + 1), name: "Left")
              right = source |> Situ.filter(&(rem(&1, 3) == 0), name: "Right")
              far = Situ.map(source, &(-&1), name: "Far", async: true)

              joined = Situ.join(left, right, Reproducible.exact(), name: "Join")
              Situ.each(joined, &send(test, {:joined, &1}), name: "Joined")

              [left, far]
              |> Situ.zip(name: "Zip")
              |> Situ.each(&send(test, {:zipped, &1}), name: "Zipped")
            end,
            pipeline: @settings
          )

        for {which, pause} <- moves do
          for _ <- 1..pause, do: :erlang.yield()
          relocate(p, which)
        end

        assert {:ok, _} = Pipeline.await(p)
        assert received(:joined) == for(i <- 1..2_000, rem(i, 3) == 0, do: {i + 1, i})
        assert received(:zipped) == for(i <- 1..2_000, do: [i + 1, -i])
        true
      end
    end

    defp relocate(p, which) do
      for {pid, %{members: members}} <- shared_processes(p), members != %{} do
        {id, _state} = Enum.at(members, rem(which, map_size(members)))
        send(pid, {:situ, {:to, id, :relocate}})
      end
    catch
      :exit, _the_pipeline_has_ended -> :ok
    end
  end

  defp received(kind, values \\ []) do
    receive do
      {^kind, value} -> received(kind, [value | values])
    after
      0 -> Enum.reverse(values)
    end
  end
end
