defmodule Situ.Cluster.Log.Nats.Subjects do
  @moduledoc false
  # Lists and deletes the JetStream streams and keys that belong to a log.
  alias Situ.{Error, JSON}
  alias Situ.Cluster.Log
  alias Situ.Cluster.Log.Nats
  alias Situ.Cluster.Log.Nats.Api

  @doc "Lists the streams whose JetStream names begin with `prefix`, and the keys in the JetStream stream `keys`."
  @spec list_subjects(Nats.t(), String.t(), String.t()) ::
          {:ok, [Log.subject_info()]} | {:error, Error.t()}
  def list_subjects(log, prefix, keys) do
    with {:ok, streams} <- list_streams(log, prefix, 0, []),
         {:ok, key_infos} <- list_keys(log, keys, 0, []),
         do: {:ok, streams ++ key_infos}
  end

  # The server returns the list in pages.
  defp list_streams(log, prefix, offset, acc) do
    body = JSON.encode(%{"offset" => offset, "subject" => "situ.s.>"})

    case Api.request_json(log, log.api <> "STREAM.LIST", body, 10_000) do
      {:ok, %{"streams" => page, "total" => total}} when is_list(page) and page != [] ->
        acc = acc ++ for(info <- page, summary <- stream_summary(info, prefix), do: summary)
        next = offset + length(page)
        if next < total, do: list_streams(log, prefix, next, acc), else: {:ok, acc}

      {:ok, %{"error" => error}} ->
        {:error, Api.server_error(error)}

      {:ok, _empty} ->
        {:ok, acc}

      {:error, error} ->
        {:error, error}
    end
  end

  defp stream_summary(
         %{"config" => %{"name" => name, "subjects" => [subject]}, "state" => state},
         prefix
       ) do
    with true <- String.starts_with?(name, prefix), "situ.s." <> token <- subject do
      entries = state["messages"] || 0
      # For a stream that never had an entry, the server returns a meaningless time.
      written = if (state["last_seq"] || 0) > 0, do: parse_time(state["last_ts"])
      subject = {:stream, URI.decode(token)}
      [%{subject: subject, entries: entries, bytes: state["bytes"], written: written}]
    else
      _ -> []
    end
  end

  defp stream_summary(_another, _prefix), do: []

  defp parse_time(text) do
    with true <- is_binary(text), {:ok, at, _offset} <- DateTime.from_iso8601(text) do
      DateTime.to_unix(at, :nanosecond)
    else
      _ -> nil
    end
  end

  defp list_keys(log, keys, offset, acc) do
    body = JSON.encode(%{"subjects_filter" => "situ.k.>", "offset" => offset})

    case Api.request_json(log, log.api <> "STREAM.INFO." <> keys, body, 10_000) do
      {:ok, %{"state" => %{"subjects" => page}} = info} when map_size(page) > 0 ->
        acc = acc ++ for({"situ.k." <> token, n} <- page, do: key_summary(token, n))
        next = offset + map_size(page)
        if next < (info["total"] || 0), do: list_keys(log, keys, next, acc), else: {:ok, acc}

      {:ok, %{"error" => error}} ->
        {:error, Api.server_error(error)}

      {:ok, _empty} ->
        {:ok, acc}

      {:error, error} ->
        {:error, error}
    end
  end

  # Only the last entry of a key counts.
  defp key_summary(token, n),
    do: %{subject: {:key, URI.decode(token)}, entries: min(n, 1), bytes: nil, written: nil}

  @doc "Deletes a JetStream stream and its files."
  @spec delete_stream(Nats.t(), String.t()) :: :ok | {:error, Error.t()}
  def delete_stream(log, stream),
    do:
      log
      |> Api.request_json(log.api <> "STREAM.DELETE." <> stream, "", 10_000)
      |> check_success()

  @doc "Deletes all messages of a subject."
  @spec purge_subject(Nats.t(), String.t(), String.t()) :: :ok | {:error, Error.t()}
  def purge_subject(log, stream, subject) do
    body = JSON.encode(%{"filter" => subject})
    log |> Api.request_json(log.api <> "STREAM.PURGE." <> stream, body, 10_000) |> check_success()
  end

  defp check_success({:ok, %{"success" => true}}), do: :ok
  defp check_success({:ok, %{"error" => %{"err_code" => 10_059}}}), do: :ok
  defp check_success({:ok, %{"error" => error}}), do: {:error, Api.server_error(error)}

  defp check_success({:ok, _other}),
    do: {:error, Api.unreachable_error("the reply is incomplete")}

  defp check_success({:error, error}), do: {:error, error}
end
