defmodule Situ.Remote.Log.Nats.Layout do
  @moduledoc false
  # The JetStream streams of a log: how they are made, and whether those of a server can be used.
  alias Situ.Error
  alias Situ.Remote.Log.Nats
  alias Situ.Remote.Log.Nats.Api

  @doc "The settings that streams are made with."
  @spec config(keyword()) :: map()
  def config(opts) do
    %{
      "storage" => "file",
      "num_replicas" => opts[:replicas],
      "allow_direct" => true,
      "discard" => if(opts[:when_full] == :refuse, do: "new", else: "old"),
      "max_bytes" => opts[:max_bytes] || -1,
      "max_age" => opts[:max_age] || 0
    }
  end

  @doc "Makes the stream of the keys, or brings it up to date; a log of an older layout is refused."
  @spec prepare(Nats.t()) :: :ok | {:error, Error.t()}
  def prepare(log) do
    # The limits of retention are for streams. Of each key the server keeps the last two entries.
    keys =
      Map.merge(Map.take(log.config, ~w(storage num_replicas allow_direct)), %{
        "name" => log.stream <> "_KEYS",
        "subjects" => ["situ.k.>"],
        "max_msgs_per_subject" => 2
      })

    with :ok <- not_older(log),
         {:error, %Error{code: :no_stream}} <- Api.info(log, keys["name"]) do
      Api.made(log, keys)
    else
      # An older version kept one entry of each key.
      {:ok, %{"config" => %{"max_msgs_per_subject" => 1} = config}} ->
        Api.change_stream(log, %{config | "max_msgs_per_subject" => 2})

      {:ok, _info} ->
        :ok

      error ->
        error
    end
  end

  # One JetStream stream for all of ours: nothing could be written beside it, since it takes their subjects.
  defp not_older(log) do
    case Api.info(log, log.stream) do
      {:ok, _info} ->
        {:error,
         Error.new(
           :old_layout,
           "the server has a log of an older version of Situ (#{log.stream})",
           why: "all streams were one JetStream stream; now each has its own",
           fix: "remove it when nobody needs it any more: nats stream rm #{log.stream}"
         )}

      {:error, %Error{code: :no_stream}} ->
        :ok

      error ->
        error
    end
  end
end
