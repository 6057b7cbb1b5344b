defmodule Situ.Ports.DispatcherTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property

  alias Situ.Message
  alias Situ.Ports.{Dispatcher, Subscriber}
  alias Situ.Ports.Dispatcher.{Broadcast, Demand, Partition}

  # Consumers are numbers. A step is {kind, consumer, n}; the messages are numbered from 1.
  @consumers 3
  defp steps, do: list({integer(0, 5), integer(0, @consumers - 1), integer(1, 6)})

  # Models, each a list of consumers and a list of waiting messages, which give one message at a time.

  defp model_options(Partition), do: [partitions: @consumers, hash: &hash/1]
  defp model_options(_module), do: []
  defp hash(%{data: n} = message) when rem(n, 7) == 0, do: {message, 0}
  defp hash(%{data: n}) when rem(n, 11) == 0, do: :none
  defp hash(%{data: n} = message), do: {message, rem(n, @consumers)}

  # The second consumer of a broadcast takes only even numbers.
  defp selected?(Broadcast, 1, n), do: rem(n, 2) == 0
  defp selected?(_module, _consumer, _n), do: true
  defp options(Broadcast, 1), do: [selector: &(rem(&1.data, 2) == 0)]
  defp options(Partition, consumer), do: [partition: consumer]
  defp options(_module, _consumer), do: []

  defp partition(n), do: with({_message, partition} <- hash(message(n)), do: partition)
  defp message(n), do: %Message{data: n, originating_time: n}

  # {consumers: %{consumer => {demand, age}}, waiting, age}; older consumers have a smaller age.
  defp model, do: %{asked: %{}, waiting: [], age: 0}

  defp touch(%{age: age} = model, consumer, demand),
    do: %{model | asked: Map.put(model.asked, consumer, {demand, age}), age: age + 1}

  # What is sent now: a list of {consumer, message}.
  defp give(_module, %{waiting: []} = model, sent), do: {sent, model}

  defp give(Demand, model, sent) do
    ready = for {consumer, {demand, age}} <- model.asked, demand > 0, do: {-demand, age, consumer}

    case Enum.sort(ready) do
      [] ->
        {sent, model}

      [{demand, _age, consumer} | _] ->
        {now, later} = Enum.split(model.waiting, -demand)
        model = touch(%{model | waiting: later}, consumer, -demand - length(now))
        give(Demand, model, sent ++ Enum.map(now, &{consumer, &1}))
    end
  end

  defp give(Broadcast, %{waiting: [n | rest]} = model, sent) do
    if model.asked == %{} or Enum.any?(model.asked, fn {_, {demand, _}} -> demand == 0 end) do
      {sent, model}
    else
      takers = for {consumer, _} <- model.asked, selected?(Broadcast, consumer, n), do: consumer

      asked =
        Map.new(model.asked, fn {consumer, {demand, age}} ->
          {consumer, {if(consumer in takers, do: demand - 1, else: demand), age}}
        end)

      give(Broadcast, %{model | waiting: rest, asked: asked}, sent ++ Enum.map(takers, &{&1, n}))
    end
  end

  defp give(Partition, model, sent) do
    {left, {sent, asked}} =
      Enum.flat_map_reduce(model.waiting, {sent, model.asked}, fn n, {sent, asked} ->
        consumer = partition(n)

        case asked do
          %{^consumer => {demand, age}} when demand > 0 ->
            {[], {sent ++ [{consumer, n}], Map.put(asked, consumer, {demand - 1, age})}}

          _ ->
            {[n], {sent, asked}}
        end
      end)

    {sent, %{model | waiting: left, asked: asked}}
  end

  defp model_room(Broadcast, %{asked: asked, waiting: waiting}),
    do:
      (asked |> Map.values() |> Enum.map(&elem(&1, 0)) |> Enum.min(fn -> 0 end)) - length(waiting)

  defp model_room(_module, %{asked: asked, waiting: waiting}),
    do: (for({_, {demand, _}} <- asked, do: demand) |> Enum.sum()) - length(waiting)

  defp run_step(module, {kind, consumer, n}, {state, model, last, sent}) do
    key = {consumer, consumer}
    known? = is_map_key(model.asked, consumer)

    {state, model, last} =
      case kind do
        0 when known? ->
          {module.cancel(state, key), %{model | asked: Map.delete(model.asked, consumer)}, last}

        _ when not known? and kind < 3 ->
          {:ok, state} = module.subscribe(state, key, options(module, consumer))
          {state, touch(model, consumer, 0), last}

        k when known? and k < 4 ->
          {demand, _age} = model.asked[consumer]
          {module.add_demand(state, key, n), touch(model, consumer, demand + n), last}

        _ ->
          new = Enum.to_list((last + 1)..(last + n))
          {[], state} = module.push(state, Enum.map(new, &message/1))

          kept =
            if module == Partition, do: Enum.reject(new, &(partition(&1) == :none)), else: new

          {state, %{model | waiting: model.waiting ++ kept}, last + n}
      end

    {parts, [], state} = module.take(state)
    got = for {{consumer, _}, messages} <- parts, m <- messages, do: {consumer, m.data}
    {expected, model} = give(module, model, [])
    assert Enum.group_by(got, &elem(&1, 0)) == Enum.group_by(expected, &elem(&1, 0))
    assert module.available_room(state) == model_room(module, model)
    assert module.waiting_count(state) == length(model.waiting)
    {state, model, last, sent ++ got}
  end

  for module <- [Demand, Broadcast, Partition] do
    property "#{inspect(module)} gives each consumer what the model gives it", numtests: 400 do
      forall steps <- steps() do
        module = unquote(module)
        {:ok, state} = module.new(model_options(module))

        {_state, model, last, sent} =
          Enum.reduce(steps, {state, model(), 0, []}, &run_step(module, &1, &2))

        if module != Broadcast do
          numbers = Enum.map(sent, &elem(&1, 1))

          dropped =
            if module == Partition,
              do: Enum.filter(1..last//1, &(partition(&1) == :none)),
              else: []

          assert Enum.sort(numbers ++ model.waiting ++ dropped) == Enum.to_list(1..last//1)
        end

        for {_consumer, part} <- Enum.group_by(sent, &elem(&1, 0), &elem(&1, 1)),
            do: assert(part == Enum.sort(Enum.uniq(part)))
      end
    end
  end

  defp subscriber(tag), do: %{Subscriber.new(tag, self(), nil) | monitor: make_ref()}

  defp start(spec, consumers) do
    {:ok, dispatcher} = Dispatcher.new(spec)

    Enum.reduce(consumers, dispatcher, fn {tag, opts, demand}, dispatcher ->
      {:ok, dispatcher} = Dispatcher.subscribe(dispatcher, subscriber(tag), opts)
      {:ok, dispatcher} = Dispatcher.add_demand(dispatcher, {self(), tag}, demand)
      dispatcher
    end)
  end

  defp received(tag) do
    receive do
      {:"$gen_consumer", {_, ^tag}, messages} when is_list(messages) ->
        Enum.map(messages, & &1.data) ++ received(tag)
    after
      0 -> []
    end
  end

  test "what a consumer that leaves has not received goes to the others" do
    dispatcher = start(:demand, [{:a, [], 2}])
    dispatcher = Dispatcher.push(dispatcher, Enum.map(1..5, &message/1))
    assert received(:a) == [1, 2]
    dispatcher = Dispatcher.remove_consumers(dispatcher, &(&1.tag == :a))
    {:ok, dispatcher} = Dispatcher.subscribe(dispatcher, subscriber(:b), [])
    {:ok, dispatcher} = Dispatcher.add_demand(dispatcher, {self(), :b}, :infinity)
    assert received(:b) == [3, 4, 5]
    assert Dispatcher.close(dispatcher, 9) |> Dispatcher.drained?()
    assert_received {:"$gen_consumer", {_, :b}, {:cancel, {:shutdown, {:closed, 9}}}}
  end

  test "a consumer is closed after the messages that wait for it" do
    dispatcher =
      start({:partition, partitions: [:odd, :even], hash: &{&1, parity(&1)}}, [
        {:a, [partition: :odd], 1},
        {:b, [partition: :even], 5}
      ])

    dispatcher = Dispatcher.push(dispatcher, Enum.map(1..5, &message/1)) |> Dispatcher.close(9)
    assert received(:b) == [2, 4]
    assert_received {:"$gen_consumer", {_, :b}, {:cancel, {:shutdown, {:closed, 9}}}}
    refute_received {:"$gen_consumer", {_, :a}, {:cancel, _}}
    {:ok, dispatcher} = Dispatcher.add_demand(dispatcher, {self(), :a}, 5)
    assert received(:a) == [1, 3, 5]
    assert Dispatcher.close(dispatcher, 9) |> Dispatcher.drained?()
  end

  defp parity(%{data: n}), do: if(rem(n, 2) == 1, do: :odd, else: :even)

  test "messages that no consumer claims are dropped once the pipeline is stopped" do
    dispatcher =
      start({:partition, partitions: 2, hash: &{&1, rem(&1.data, 2)}}, [
        {:a, [partition: 1], 1}
      ])

    dispatcher = Dispatcher.push(dispatcher, Enum.map(1..4, &message/1))
    assert Dispatcher.waiting_count(dispatcher) == 3
    dispatcher = Dispatcher.discard_unclaimed(dispatcher)
    assert Dispatcher.waiting_count(dispatcher) == 1
    dispatcher = Dispatcher.remove_consumers(dispatcher, fn _ -> true end)
    assert Dispatcher.drained?(dispatcher)
    assert Dispatcher.available_room(dispatcher) == :infinity
    assert Dispatcher.push(dispatcher, [message(5)]) |> Dispatcher.drained?()
  end

  test "a selector that raises ends only its own subscription" do
    other = spawn(fn -> Process.sleep(:infinity) end)
    dispatcher = start(:broadcast, [{:a, [], 9}])
    bad = %{subscriber(:b) | pid: other}

    {:ok, dispatcher} = Dispatcher.subscribe(dispatcher, bad, selector: fn _ -> raise "no" end)

    {:ok, dispatcher} = Dispatcher.add_demand(dispatcher, {other, :b}, 2)
    dispatcher = Dispatcher.push(dispatcher, Enum.map(1..5, &message/1))
    assert received(:a) == [1, 2, 3, 4, 5]
    assert Enum.map(dispatcher.consumers, & &1.tag) == [:a]
    Process.exit(other, :kill)
  end

  test "an error of hash: drops one message and reports it to the component" do
    hash = fn
      %{data: 2} -> raise "no"
      %{data: 3} = message -> {message, :nowhere}
      message -> {message, 0}
    end

    dispatcher = start({:partition, partitions: [0], hash: hash}, [{:a, [partition: 0], 9}])
    Dispatcher.push(dispatcher, Enum.map(1..4, &message/1))
    assert received(:a) == [1, 4]
    assert_received {:situ_dispatch_failed, %Situ.Error{code: :bad_partition, what: what}}
    assert what =~ "raised: no"
    assert_received {:situ_dispatch_failed, %Situ.Error{code: :bad_partition, what: what}}
    assert what =~ ":nowhere"
  end

  test "subscriptions and dispatchers with bad options are refused" do
    for spec <- [
          :roundrobin,
          {:partition, 3},
          {:partition, []},
          {:partition, partitions: 0},
          {:partition, partitions: [:a, :a], hash: & &1},
          {:partition, partitions: [:a]},
          {:partition, partitions: 2, hash: 3}
        ],
        do: assert({:error, %Situ.Error{}} = Dispatcher.new(spec))

    dispatcher = start({:partition, partitions: 2}, [{:a, [partition: 0], 1}])

    for {opts, text} <- [
          {[], "partition: is missing"},
          {[partition: 7], "7 is not a partition"},
          {[partition: 0], "already taken"}
        ] do
      assert {:error, error} = Dispatcher.subscribe(dispatcher, subscriber(:b), opts)
      assert error.what =~ text
    end

    dispatcher = start(:broadcast, [{:a, [], 1}])
    assert {:error, :already_subscribed} = Dispatcher.subscribe(dispatcher, subscriber(:b), [])
    other = %{subscriber(:b) | pid: spawn(fn -> :ok end)}
    assert {:error, error} = Dispatcher.subscribe(dispatcher, other, selector: 3)
    assert error.what =~ "selector:"
    assert Dispatcher.add_demand(dispatcher, {self(), :nobody}, 1) == :error
  end
end
