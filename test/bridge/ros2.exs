# Situ's side of ROS 2, live: hears 100 messages of /chatter and publishes 200 on /situ/words. `ros2.exs PORT`.
{:ok, _} = Application.ensure_all_started(:situ_bridge)
alias Situ.Bridge.Ros2
[port] = System.argv()
me = self()
router = "tcp/127.0.0.1:#{port}"

{:ok, p} =
  Situ.Pipeline.start_link(fn p ->
    p
    |> Ros2.subscribe("/chatter", router: router, ros_type: "std_msgs/msg/String")
    |> Situ.map(fn text, m -> {m.originating_time, text} end)
    |> Situ.each(&send(me, {:got, &1}))
  end)

got =
  for _ <- 1..100,
      do: receive(do: ({:got, got} -> got), after: (60_000 -> raise("nothing more came")))

numbers = for {_, "hello " <> n} <- got, do: String.to_integer(n)
true = numbers == Enum.to_list(hd(numbers)..List.last(numbers))
# The sender's times are those of now.
{time, _} = hd(got)
true = abs(System.os_time(:nanosecond) - time) < 60_000_000_000

{:ok, _} =
  Situ.Pipeline.run(fn p ->
    p
    |> Situ.from_enumerable(for(n <- 0..199, do: {1_700_000_000_000_000_000 + n, "word #{n}"}))
    |> Ros2.publish("/situ/words", router: router, linger: 10_000)
  end)

{:ok, _} = Situ.Pipeline.stop(p)
