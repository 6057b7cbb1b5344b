defmodule Situ.Cluster.Log.Nats.Layout do
  @moduledoc false
  # Creates the JetStream streams of a log, and checks that the existing streams of a server can be used.
  alias Situ.Error
  alias Situ.Cluster.Log.Nats
  alias Situ.Cluster.Log.Nats.Api

  @doc "Returns the settings for new streams."
  @spec stream_config(keyword()) :: map()
  def stream_config(opts) do
    %{
      "storage" => "file",
      "num_replicas" => opts[:replicas],
      "allow_direct" => true,
      "discard" => if(opts[:when_full] == :refuse, do: "new", else: "old"),
      "max_bytes" => opts[:max_bytes] || -1,
      "max_age" => opts[:max_age] || 0
    }
  end

  @doc "Creates or updates the stream of the keys. Returns an error if the server has a log with an older layout."
  @spec prepare_streams(Nats.t()) :: :ok | {:error, Error.t()}
  def prepare_streams(log) do
    # Retention limits apply only to streams. The server keeps the last two entries of each key.
    keys =
      Map.merge(Map.take(log.config, ~w(storage num_replicas allow_direct)), %{
        "name" => log.stream <> "_KEYS",
        "subjects" => ["situ.k.>"],
        "max_msgs_per_subject" => 2
      })

    with :ok <- check_layout(log),
         {:error, %Error{code: :no_stream}} <- Api.stream_info(log, keys["name"]) do
      Api.create_stream(log, keys)
    else
      # Older versions kept one entry of each key.
      {:ok, %{"config" => %{"max_msgs_per_subject" => 1} = config}} ->
        Api.update_stream(log, %{config | "max_msgs_per_subject" => 2})

      {:ok, _info} ->
        :ok

      error ->
        error
    end
  end

  # The older layout had one JetStream stream that takes all subjects, so no other stream could be created for them.
  defp check_layout(log) do
    case Api.stream_info(log, log.stream) do
      {:ok, _info} ->
        {:error,
         Error.new(
           :old_layout,
           "the server has a log of an older version of Situ (#{log.stream})",
           why: "all streams shared one JetStream stream; now each has its own",
           fix: "remove it when it is no longer needed: nats stream rm #{log.stream}"
         )}

      {:error, %Error{code: :no_stream}} ->
        :ok

      error ->
        error
    end
  end
end
