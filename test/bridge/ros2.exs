# Situ's side of the live ROS 2 test. `ros2.exs PORT FOLDER`: receives 100 messages from /chatter
# and publishes 200 on /situ/words; receives the last three of a latched topic, and publishes one;
# calls a service, and offers one.
{:ok, _} = Application.ensure_all_started(:situ_bridge)
alias Situ.Bridge.Ros2
[port, folder] = System.argv()
me = self()
at = [router: "tcp/127.0.0.1:#{port}"]
word = [ros_type: "std_msgs/msg/String"] ++ at
add = "int64 a\nint64 b\n---\nint64 sum\n"
add_type = "example_interfaces/srv/AddTwoInts"

next = fn -> receive(do: ({:got, got} -> got), after: (60_000 -> raise("nothing more came"))) end

there = fn file ->
  path = Path.join(folder, file)
  found = Enum.find(1..1_200, fn _ -> File.exists?(path) or (Process.sleep(50) && false) end)
  found || raise("#{file} did not come")
end

hear = fn topic, opts ->
  Situ.Pipeline.start_link(fn p ->
    p
    |> Ros2.subscribe(topic, opts)
    |> Situ.map(fn text, m -> {m.originating_time, text} end)
    |> Situ.each(&send(me, {:got, &1}))
  end)
end

{:ok, p} = hear.("/chatter", word)
got = for _ <- 1..100, do: next.()
numbers = for {_, "hello " <> n} <- got, do: String.to_integer(n)
true = numbers == Enum.to_list(hd(numbers)..List.last(numbers)//1)
# The sender's times are current times.
{time, _} = hd(got)
true = abs(System.os_time(:nanosecond) - time) < 60_000_000_000

{:ok, _} =
  Situ.Pipeline.run(fn p ->
    p
    |> Situ.from_enumerable(for(n <- 0..199, do: {1_700_000_000_000_000_000 + n, "word #{n}"}))
    |> Ros2.publish("/situ/words", [linger: 10_000] ++ at)
  end)

{:ok, _} = Situ.Pipeline.stop(p)
flush = fn flush -> receive(do: ({:got, _} -> flush.(flush)), after: (0 -> :ok)) end
flush.(flush)

# The subscriber must be neither too early nor too late. Without `latch:` it must not receive
# older messages, which would precede the others.
{:ok, p} = hear.("/map_theirs", [latch: true, depth: 3] ++ word)
["old 2", "old 3", "old 4"] = for _ <- 1..3, do: elem(next.(), 1)
{:ok, _} = Situ.Pipeline.stop(p)

{:ok, p} =
  Situ.Pipeline.start_link(fn p ->
    p
    |> Situ.event_source(fn post -> send(me, {:post, post}) && fn -> :ok end end)
    |> Ros2.publish("/map_ours", [latch: true, depth: 2] ++ word)
  end)

post = receive(do: ({:post, post} -> post))
for n <- 0..4, do: post.("map #{n}")
# Subscribers that appear after this marker file are late.
{:ok, q} = hear.("/map_ours", [latch: true, depth: 2] ++ word)
"map 4" = Enum.find(Stream.repeatedly(fn -> elem(next.(), 1) end), &(&1 == "map 4"))
File.touch!(Path.join(folder, "latched"))
there.("late")
post.("map 5")

# Services: a single call, many concurrent calls of one client, refusals, and unknown services.
{:ok, %{"sum" => 5}} = Ros2.call("/add_theirs", add_type, add, %{"a" => 2, "b" => 3}, at)
{:ok, client} = Ros2.client("/add_theirs", add_type, add, at)
ask = &Ros2.ask(client, %{"a" => &1, "b" => 1}, 20_000)

sums =
  1..50
  |> Task.async_stream(ask, max_concurrency: 50, timeout: :infinity)
  |> Enum.map(&elem(&1, 1))

true = sums == for(n <- 1..50, do: {:ok, %{"sum" => n + 1}})
{:error, %{code: :ros_refused, why: why}} = Ros2.ask(client, %{"a" => -1, "b" => 1})
true = why =~ "no debts"
{:error, %{code: :not_writable}} = Ros2.ask(client, %{"a" => "two"})
:ok = Ros2.stop(client)
{:error, %{code: :ros_refused, what: none}} = Ros2.call("/nobody", add_type, add, %{}, at)
true = none =~ "no server offers"
other = String.replace(add, "int64 b", "int32 b")
{:error, %{code: :ros_refused}} = Ros2.call("/add_theirs", add_type, other, %{}, at)

adding = fn
  %{"a" => a} when a < 0 -> raise "no debts here"
  %{"a" => a, "b" => b} -> {:ok, %{"sum" => a + b}}
end

{:ok, server} = Ros2.serve("/add_ours", add_type, add, adding, at)
there.("served")
{:error, %{why: "no debts here"}} = Ros2.call("/add_ours", add_type, add, %{"a" => -1}, at)
:ok = Ros2.stop(server)
{:error, %{code: :ros_refused}} = Ros2.call("/add_ours", add_type, add, %{}, at)
for p <- [p, q], do: {:ok, _} = Situ.Pipeline.stop(p)
