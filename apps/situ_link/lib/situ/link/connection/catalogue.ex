defmodule Situ.Link.Connection.Catalogue do
  @moduledoc false
  # Keeps the streams that a server has announced, and the callers waiting for the first announcement.
  alias Situ.Error

  defstruct known: nil, waiting: []

  @type t :: %__MODULE__{}

  @spec new() :: t()
  def new, do: %__MODULE__{}

  @doc """
  Replies to `from` if a list has arrived, otherwise when it arrives, or with an error after `ms`
  (`expire_waiter/3`).
  """
  @spec add_waiter(t(), GenServer.from(), non_neg_integer()) :: t()
  def add_waiter(%__MODULE__{known: nil} = catalogue, from, ms) do
    timer = Process.send_after(self(), {:waited, from}, ms)
    %{catalogue | waiting: [{from, timer} | catalogue.waiting]}
  end

  def add_waiter(%__MODULE__{known: known} = catalogue, from, _ms) do
    GenServer.reply(from, {:ok, known})
    catalogue
  end

  @doc "Merges a server's list of streams into the catalogue and skips invalid entries."
  @spec merge_streams(t(), [term()]) :: t()
  def merge_streams(%__MODULE__{} = catalogue, streams) do
    found =
      for %{"name" => name, "type" => type} when is_binary(name) and is_binary(type) <- streams,
          into: %{},
          do: {name, type}

    known = Map.merge(catalogue.known || %{}, found)
    reply_to_waiters(%{catalogue | known: known}, {:ok, known})
  end

  @doc "Replies with `error` to all waiting callers."
  @spec fail_waiters(t(), Error.t()) :: t()
  def fail_waiters(%__MODULE__{} = catalogue, error),
    do: reply_to_waiters(catalogue, {:error, error})

  defp reply_to_waiters(catalogue, reply) do
    for {from, timer} <- catalogue.waiting do
      _ = Process.cancel_timer(timer)
      GenServer.reply(from, reply)
    end

    %{catalogue | waiting: []}
  end

  @doc "Replies with `error` to a caller whose timeout has passed."
  @spec expire_waiter(t(), GenServer.from(), Error.t()) :: t()
  def expire_waiter(%__MODULE__{} = catalogue, from, error) do
    case List.keytake(catalogue.waiting, from, 0) do
      {_, waiting} ->
        GenServer.reply(from, {:error, error})
        %{catalogue | waiting: waiting}

      nil ->
        catalogue
    end
  end
end
