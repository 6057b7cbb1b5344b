defmodule Situ.Bridge.Ros.Db3.Summary do
  @moduledoc false
  # Builds the summary of a ROS 2 bag, as YAML. The bag contains it in its table `metadata`, and a folder with the bag
  # contains it as `metadata.yaml`, which ROS 2 needs to play the folder.
  alias Situ.Bridge.RawChannel
  alias Situ.Bridge.Ros.Db3.Sqlite

  @doc "Returns the version of the format, and the fields below `rosbag2_bagfile_information`."
  @spec build(String.t(), [{RawChannel.t(), non_neg_integer()}], nil | {integer(), integer()}) ::
          {version :: pos_integer(), String.t()}
  def build(file, topics, span) do
    version = find_version(topics)
    {first, last} = span || {0, 0}
    count = topics |> Enum.map(&elem(&1, 1)) |> Enum.sum()

    span = """
    duration:
      nanoseconds: #{last - first}
    starting_time:
      nanoseconds_since_epoch: #{first}
    message_count: #{count}
    """

    file_entry = "path: #{quote_text(file)}\n" <> span

    summary = """
    version: #{version}
    storage_identifier: sqlite3
    relative_file_paths:
      - #{quote_text(file)}
    #{span}topics_with_message_count:#{list_topics(topics, version)}
    compression_format: ""
    compression_mode: ""
    files:
      - #{file_entry |> indent(4) |> String.trim_leading()}custom_data: ~
    ros_distro: situ
    """

    {version, summary}
  end

  # Up to version 8, the quality of service is text with numbers; since version 9 (Jazzy), it is a list with names.
  defp find_version(topics) do
    if Enum.any?(topics, fn {channel, _} -> quality_of(channel) =~ ~r/\bhistory: *\d/ end),
      do: 8,
      else: 9
  end

  defp quality_of(channel),
    do: for({"offered_qos_profiles", text} <- channel.metadata, into: "", do: text)

  defp list_topics([], _version), do: " []"

  defp list_topics(topics, version) do
    for {channel, count} <- topics, into: "" do
      hash = for {"topic_type_hash", text} <- channel.metadata, into: "", do: text

      """

        - topic_metadata:
            name: #{quote_text(channel.topic)}
            type: #{quote_text(elem(channel.schema, 0))}
            serialization_format: #{quote_text(channel.encoding)}
            offered_qos_profiles: #{format_quality(quality_of(channel), version)}
            type_description_hash: #{quote_text(hash)}
          message_count: #{count}\
      """
    end
  end

  defp format_quality("- " <> _ = list, 9), do: String.trim_trailing("\n" <> indent(list, 8))
  defp format_quality(_none, 9), do: "[]"
  defp format_quality(text, _version), do: quote_text(text)

  # A string in JSON is one in YAML.
  defp quote_text(text), do: text |> Situ.JSON.encode() |> IO.iodata_to_binary()

  defp build_file(summary), do: "rosbag2_bagfile_information:\n" <> indent(summary, 2)

  defp indent(text, count) do
    margin = String.duplicate(" ", count)
    text |> String.split("\n", trim: true) |> Enum.map_join(&(margin <> &1 <> "\n"))
  end

  @doc """
  Writes `metadata.yaml` next to a complete bag if the bag is the only file of its folder. Other folders are left as
  they are, because they may belong to another bag.
  """
  @spec write_beside(Path.t()) :: :ok | {:error, Situ.Error.t()}
  def write_beside(path) do
    folder = Path.dirname(path)

    with {:ok, [_]} <- File.ls(folder),
         {:ok, [[hex]]} <- Sqlite.query(path, "select hex(metadata) from metadata"),
         text = hex |> Base.decode16!() |> build_file(),
         {:error, reason} <- File.write(Path.join(folder, "metadata.yaml"), text) do
      why = to_string(:file.format_error(reason))
      {:error, Situ.Error.new(:io, "cannot write metadata.yaml next to #{path}", why: why)}
    else
      {:error, %Situ.Error{} = error} -> {:error, error}
      _other -> :ok
    end
  end
end
