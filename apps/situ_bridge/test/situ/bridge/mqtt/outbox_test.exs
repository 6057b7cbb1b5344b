defmodule Situ.Bridge.Mqtt.OutboxTest do
  # A publisher's outbox and a subscription on both sides of a broker of this test, whose connections end anywhere.
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Bridge.Mqtt.Outbox
  doctest Outbox

  property "no message is lost or doubled with QoS 2, wherever connections end" do
    forall {count, window, steps} <- {integer(1, 40), integer(1, 5), list(integer(0, 9))} do
      outbox =
        Enum.reduce(1..count, %Outbox{}, fn n, outbox ->
          outbox |> Outbox.add(n, 100) |> elem(1)
        end)

      broker = %{held: %{}, delivered: []}
      {outbox, broker} = run_steps(steps, window, {outbox, broker})
      # After the faults, a connection without faults delivers the rest.
      {outbox, broker} = run_steps([0], window, {outbox, broker})
      {outbox, broker} = run_steps(List.duplicate(9, count * 2), window, {outbox, broker})
      Outbox.count(outbox) == 0 and Enum.sort(broker.delivered) == Enum.to_list(1..count)
    end
  end

  test "identifiers wrap, and none is used twice at a time" do
    {:ok, outbox} = Outbox.add(%Outbox{}, 0, 70_000)
    {[{1, 0, false}], outbox} = Outbox.take_waiting(outbox, 1)

    outbox =
      Enum.reduce(1..65_534, outbox, fn n, outbox ->
        {:ok, outbox} = Outbox.add(outbox, n, 70_000)
        {[{id, ^n, false}], outbox} = Outbox.take_waiting(outbox, 2)
        assert id == n + 1
        Outbox.confirm(outbox, id)
      end)

    assert Outbox.add(outbox, "next", 70_000) == :full
    {:ok, outbox} = outbox |> Outbox.confirm(1) |> Outbox.add("next", 70_000)
    assert {[{1, "next", false}], _} = Outbox.take_waiting(outbox, 1)
  end

  test "all messages are sent again if the broker lost the session" do
    outbox =
      Enum.reduce(1..3, %Outbox{}, fn n, outbox -> outbox |> Outbox.add(n, 10) |> elem(1) end)

    {_, outbox} = Outbox.take_waiting(outbox, 2)
    outbox = Outbox.receive(outbox, 1)
    assert {[1], kept} = Outbox.restart(outbox, true)
    assert {[{2, 2, true}, {3, 3, false}], _} = Outbox.take_waiting(kept, 3)
    assert {[], lost} = Outbox.restart(outbox, false)
    assert {[{1, 1, false}, {2, 2, false}, {3, 3, false}], _} = Outbox.take_waiting(lost, 3)
  end

  # Each step ends the connection (0 to 2), with a part of the packets lost, or completes an exchange.
  defp run_steps(steps, window, state),
    do: Enum.reduce(steps, state, fn step, state -> run_step(step, window, state) end)

  defp run_step(0, _window, {outbox, broker}) do
    {released, outbox} = Outbox.restart(outbox, true)
    Enum.reduce(released, {outbox, broker}, &release/2)
  end

  # The broker gets the messages, and its answers are lost.
  defp run_step(1, window, {outbox, broker}) do
    {messages, outbox} = Outbox.take_waiting(outbox, window)
    run_step(0, window, {outbox, Enum.reduce(messages, broker, &hold/2)})
  end

  # The broker releases, and its confirmation is lost.
  defp run_step(2, window, {outbox, broker}) do
    {messages, outbox} = Outbox.take_waiting(outbox, window)
    broker = Enum.reduce(messages, broker, &hold/2)

    outbox =
      Enum.reduce(messages, outbox, fn {id, _, _}, outbox -> Outbox.receive(outbox, id) end)

    broker = Enum.reduce(messages, broker, fn {id, _, _}, broker -> deliver(id, broker) end)
    run_step(0, window, {outbox, broker})
  end

  defp run_step(_step, window, {outbox, broker}) do
    {messages, outbox} = Outbox.take_waiting(outbox, window)
    broker = Enum.reduce(messages, broker, &hold/2)

    outbox =
      Enum.reduce(messages, outbox, fn {id, _, _}, outbox -> Outbox.receive(outbox, id) end)

    Enum.reduce(messages, {outbox, broker}, fn {id, _, _}, state -> release(id, state) end)
  end

  defp hold({id, message, _duplicate?}, broker), do: put_in(broker.held[id], message)

  defp release(id, {outbox, broker}), do: {Outbox.confirm(outbox, id), deliver(id, broker)}

  defp deliver(id, broker) do
    case Map.pop(broker.held, id) do
      {nil, _} -> broker
      {message, held} -> %{broker | held: held, delivered: [message | broker.delivered]}
    end
  end
end
