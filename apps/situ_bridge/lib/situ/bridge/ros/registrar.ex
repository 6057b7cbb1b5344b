defmodule Situ.Bridge.Ros.Registrar do
  @moduledoc false
  # Registers a node with the master, and checks every second whether the master was restarted, since a new master knows
  # no nodes. The calls may take seconds, so the registrar runs in a separate process.
  require Logger
  alias Situ.Bridge.Ros.XmlRpc

  @check_ms 1_000
  @unregister_ms 1_000

  @doc "Starts the process, linked to the caller. A subscriber receives `{:publishers, uris}`."
  @spec start_link(pid(), Situ.Bridge.Ros.Address.t(), Situ.Bridge.Ros.Node.role(), String.t()) ::
          pid()
  def start_link(node, address, role, uri),
    do:
      spawn_link(fn ->
        register_node(%{node: node, address: address, role: role, uri: uri, logged_code: nil})
      end)

  defp register_node(state) do
    with {:ok, pid} <- master_pid(state),
         {:ok, publishers} <-
           call_master(
             state.address,
             register_method(state.role),
             register_arguments(state) ++ [state.uri]
           ) do
      if elem(state.role, 0) == :subscriber, do: send(state.node, {:publishers, publishers})

      if state.logged_code,
        do: Logger.info("ROS: the master at #{state.address.master} is reachable again")

      watch_master(%{state | logged_code: nil}, pid)
    else
      {:error, error} ->
        if state.logged_code != error.code, do: Logger.warning("ROS: #{Exception.message(error)}")
        Process.sleep(@check_ms)
        register_node(%{state | logged_code: error.code})
    end
  end

  defp watch_master(state, pid) do
    Process.sleep(@check_ms)

    case master_pid(state) do
      {:ok, ^pid} -> watch_master(state, pid)
      _ -> register_node(state)
    end
  end

  defp master_pid(state), do: call_master(state.address, "getPid", [state.address.node])

  defp register_method({:publisher, _, _, _}), do: "registerPublisher"
  defp register_method({:subscriber, _, _, _}), do: "registerSubscriber"

  defp register_arguments(%{address: address, role: {_, topic, type, _}}),
    do: [address.node, topic, type]

  @doc "Unregisters the node with a short timeout."
  def unregister_node(address, {role, topic, _, _}, uri) do
    method = if role == :publisher, do: "unregisterPublisher", else: "unregisterSubscriber"
    XmlRpc.call(address.master, method, [address.node, topic, uri], @unregister_ms)
  end

  @doc "Calls a method of the master, which replies with `[code, text, value]`, and returns the value."
  @spec call_master(Situ.Bridge.Ros.Address.t(), String.t(), list()) ::
          {:ok, term()} | {:error, Situ.Error.t()}
  def call_master(address, method, arguments) do
    with {:ok, [code, text, value]} <- XmlRpc.call(address.master, method, arguments) do
      if code == 1, do: {:ok, value}, else: {:error, refused_error(address, method, text)}
    else
      {:ok, other} -> {:error, refused_error(address, method, inspect(other, limit: 10))}
      error -> error
    end
  end

  defp refused_error(address, method, why),
    do:
      Situ.Error.new(:ros_refused, "the master at #{address.master} refused #{method}",
        why: to_string(why)
      )
end
