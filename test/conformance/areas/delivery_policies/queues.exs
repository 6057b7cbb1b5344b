defmodule Situ.Conformance.DeliveryPolicies.Queues do
  # Drives one queue step by step.
  import Situ.Conformance.Case, only: [all: 2, ms: 1]
  import Situ.Conformance.DeliveryPolicies.Policies
  alias Situ.Conformance.Text
  alias Situ.Delivery.Queue
  alias Situ.Message

  def check(%{"params" => params} = case) do
    policy = policy(params["policy"])
    start = {Queue.new(policy), []}

    {steps, {_queue, dropped}} =
      Enum.map_reduce(case["expect"]["steps"], start, &step(&1, &2, policy))

    all(case, %{"steps" => steps, "dropped" => Enum.map(dropped, & &1.data)})
  end

  # The actions of a step come from the case; everything else must be an effect of them.
  defp step(step, {queue, dropped}, policy) do
    {gives, queue, lost} = act(step, queue)

    came = %{
      "gives" => gives,
      "queue_after" => waiting(queue),
      "queue_length" => length(Queue.to_list(queue)),
      "dropped" => Enum.map(lost, &shown/1),
      "source_throttled" => throttled?(policy, queue),
      "throttled" => throttled?(policy, queue),
      "throttling" => throttled?(policy, queue),
      "queued" => lost == [] or step["v"] not in Enum.map(lost, &shown/1),
      "empty" => waiting(queue) == []
    }

    came = Map.merge(Map.take(step, ~w(do v t_ms now_ms)), Map.take(came, Map.keys(step)))
    # A part that nothing answers stays different from every expectation.
    unread = for key <- Map.keys(step) -- Map.keys(came), into: %{}, do: {key, {:unread, key}}
    {Map.merge(came, unread), {queue, dropped ++ lost}}
  end

  defp act(%{"do" => "enqueue"} = step, queue) do
    {queue, lost} =
      Queue.push(queue, %Message{data: step["v"], originating_time: ms(step["t_ms"])})

    {nil, queue, lost}
  end

  defp act(%{"do" => other}, _queue) when other not in ~w(enqueue enqueue_closing dequeue),
    do: Text.unknown!("a step of a queue", other)

  defp act(%{"do" => "enqueue_closing"} = step, queue) do
    {queue, lost} = Queue.push(queue, {:closed, ms(step["t_ms"])})
    {nil, queue, lost}
  end

  defp act(%{"do" => "dequeue"} = step, queue) do
    {entry, queue, lost} = Queue.pop(queue, ms(step["now_ms"]))
    {if(entry, do: shown(entry)), queue, lost}
  end

  # A producer waits while a full window of messages waits to be consumed.
  defp throttled?(%{kind: :throttle, window: window}, queue),
    do: length(Queue.to_list(queue)) >= window

  defp throttled?(%{throttle: true, max_queue: most}, queue),
    do: length(Queue.to_list(queue)) >= most

  defp throttled?(_policy, _queue), do: false

  defp waiting(queue), do: queue |> Queue.to_list() |> Enum.map(&shown/1)
  defp shown({:closed, _}), do: "<closing>"
  defp shown(message), do: message.data
end
