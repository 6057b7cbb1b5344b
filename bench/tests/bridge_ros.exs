defmodule Situ.Bench.BridgeRos do
  @moduledoc false
  # `bridge-ros1` sends images of 1280 x 720 from Situ's publisher to Situ's subscriber over
  # TCPROS, with both ends in one VM. `bridge-ros1-python` sends the same images with rospy
  # between two processes. Both need a master (Debian's python3-rosmaster, and for the second
  # python3-rospy and python3-sensor-msgs). Otherwise they are skipped.
  alias Situ.Bridge.Ros
  alias Situ.{Image, Pipeline}

  def tests, do: [{"bridge-ros1", &ours/1}, {"bridge-ros1-python", &rospy/1}]

  defp ours(scale) do
    with_master("bridge-ros1", fn master ->
      n = max(10, round(300 * scale))
      pixels = :crypto.strong_rand_bytes(1_280 * 720 * 3)

      pictures =
        Stream.map(1..n, fn i ->
          data = <<i::32, binary_part(pixels, 4, byte_size(pixels) - 4)::binary>>
          {i * 1_000, Image.new!(width: 1_280, height: 720, format: :rgb24, data: data)}
        end)

      me = self()
      opts = [master: master]

      Situ.Bench.measure("bridge_ros1", n, fn ->
        {:ok, receiver} =
          Pipeline.start_link(fn p ->
            p
            |> Ros.subscribe("/pictures", [high_water_mark: 2 * n] ++ opts)
            |> Situ.each(&if(match?(%{data: <<^n::32, _::binary>>}, &1), do: send(me, :last)))
          end)

        sending = [wait_for: 1, linger: 60_000, high_water_mark: 2 * n] ++ opts

        {:ok, sender} =
          Pipeline.start_link(fn p ->
            p
            |> Situ.from_enumerable(pictures, type: Image)
            |> Ros.publish("/pictures", sending)
          end)

        receive(do: (:last -> :ok), after: (120_000 -> raise("the last picture did not come")))
        Pipeline.stop(sender)
        Pipeline.stop(receiver)
        []
      end)
    end)
  end

  defp rospy(scale) do
    with_master("bridge-ros1-python", fn master ->
      n = max(10, round(300 * scale))

      env = [
        {"ROS_MASTER_URI", master},
        {"ROS_IP", "127.0.0.1"},
        {"ROS_LOG_DIR", System.tmp_dir!()}
      ]

      case Situ.Bench.python("ros1.py", ["#{n}"], env: env, python: "/usr/bin/python3") do
        {:ok, [rate, cpu]} ->
          [{"bridge_ros1_python", rate, "msg/s"}, {"bridge_ros1_python_cpu", cpu, "us/msg"}]

        :error ->
          []
      end
    end)
  end

  defp with_master(test, fun) do
    case System.find_executable("rosmaster") do
      nil -> nothing(test, "there is no rosmaster (Debian's python3-rosmaster)")
      program -> running(test, program, fun)
    end
  end

  defp running(test, program, fun) do
    number = Situ.Bench.free_port()

    port =
      Port.open({:spawn_executable, program}, [
        :binary,
        :stderr_to_stdout,
        args: ["--core", "-p", "#{number}"],
        env: [{'ROS_IP', '127.0.0.1'}, {'ROS_LOG_DIR', to_charlist(System.tmp_dir!())}]
      ])

    {:os_pid, pid} = Port.info(port, :os_pid)
    master = "http://127.0.0.1:#{number}"

    try do
      if up?(master, 100), do: fun.(master), else: nothing(test, "rosmaster does not answer")
    after
      System.cmd("kill", ["-9", "#{pid}"])
    end
  end

  defp up?(_master, 0), do: false

  defp up?(master, left) do
    case Ros.list_topics(master: master) do
      {:ok, _} ->
        true

      {:error, _} ->
        Process.sleep(100)
        up?(master, left - 1)
    end
  end

  defp nothing(test, why) do
    IO.puts(:stderr, "#{test}: nothing is measured: #{why}")
    []
  end
end
