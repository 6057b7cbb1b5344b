defmodule Situ.Link.Connection.Catalogue do
  @moduledoc false
  # Keeps the streams that a server has announced, and the callers waiting for the first announcement.
  alias Situ.Error

  defstruct streams: nil, waiters: []

  @type t :: %__MODULE__{}

  @spec new() :: t()
  def new, do: %__MODULE__{}

  @doc """
  Replies to `from` if a list has arrived, otherwise when it arrives, or with an error after `ms`
  (`expire_waiter/3`).
  """
  @spec add_waiter(t(), GenServer.from(), non_neg_integer()) :: t()
  def add_waiter(%__MODULE__{streams: nil} = catalogue, from, ms) do
    timer = Process.send_after(self(), {:waited, from}, ms)
    %{catalogue | waiters: [{from, timer} | catalogue.waiters]}
  end

  def add_waiter(%__MODULE__{streams: streams} = catalogue, from, _ms) do
    GenServer.reply(from, {:ok, streams})
    catalogue
  end

  @doc "Merges a server's list of streams into the catalogue and skips invalid entries."
  @spec merge_streams(t(), [term()]) :: t()
  def merge_streams(%__MODULE__{} = catalogue, streams) do
    announced =
      for %{"name" => name, "type" => type} when is_binary(name) and is_binary(type) <- streams,
          into: %{},
          do: {name, type}

    streams = Map.merge(catalogue.streams || %{}, announced)
    reply_to_waiters(%{catalogue | streams: streams}, {:ok, streams})
  end

  @doc "Replies with `error` to all waiting callers."
  @spec fail_waiters(t(), Error.t()) :: t()
  def fail_waiters(%__MODULE__{} = catalogue, error),
    do: reply_to_waiters(catalogue, {:error, error})

  defp reply_to_waiters(catalogue, reply) do
    for {from, timer} <- catalogue.waiters do
      _ = Process.cancel_timer(timer)
      GenServer.reply(from, reply)
    end

    %{catalogue | waiters: []}
  end

  @doc "Replies with `error` to a caller whose timeout has passed."
  @spec expire_waiter(t(), GenServer.from(), Error.t()) :: t()
  def expire_waiter(%__MODULE__{} = catalogue, from, error) do
    case List.keytake(catalogue.waiters, from, 0) do
      {_, waiters} ->
        GenServer.reply(from, {:error, error})
        %{catalogue | waiters: waiters}

      nil ->
        catalogue
    end
  end
end
