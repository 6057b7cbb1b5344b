defmodule Situ.Dataset.StoredPath do
  @moduledoc false
  # Converts paths of recordings to the form stored in a dataset file, which is relative to the
  # file, so that the file and its recordings can be moved together.

  @typedoc "Root (\"\" if the path is relative) and segments."
  @type parts :: {root :: String.t(), [String.t()]}

  @doc """
  Returns the form of `path` that the dataset file `dataset_file` stores; a relative path keeps its spelling.

      iex> Situ.Dataset.StoredPath.to_stored("/study/p01/lobby.0000", "/study/study.json")
      "p01/lobby.0000"
      iex> Situ.Dataset.StoredPath.from_stored("../old/lobby.0000", "/study/study.json")
      "/old/lobby.0000"

  The address of a recording on another machine is not changed:

      iex> Situ.Dataset.StoredPath.to_stored("situ://lab1/lobby", "/study/study.json")
      "situ://lab1/lobby"

  If the path of the dataset file is a Windows path (`C:\\\\...` or `\\\\\\\\host\\\\share\\\\...`), Windows paths are
  stored, as in the files of \\\\psi. A path on another drive or share stays absolute:

      iex> Situ.Dataset.StoredPath.to_stored("D:\\\\runs\\\\a", ~S(C:\\study\\study.pds))
      "D:\\\\runs\\\\a"
      iex> Situ.Dataset.StoredPath.from_stored("../a", ~S(C:\\study\\study.pds))
      "C:\\\\a"
  """
  @spec to_stored(Path.t(), Path.t()) :: String.t()
  def to_stored(path, dataset_file),
    do: if(address?(path), do: path, else: relative_to(path, dataset_file))

  defp relative_to(path, dataset_file) do
    style = path_style(dataset_file)
    {root, segments} = split_parts(path, style)
    {base_root, base} = folder_parts(dataset_file, style)

    cond do
      root == "" ->
        join_parts("", segments, style)

      same_segment?(resolve_root(root, base_root), base_root, style) ->
        relative_path(normalize_segments(segments), base, style)

      true ->
        join_parts(root, normalize_segments(segments), style)
    end
  end

  @doc "Returns the absolute path of the path `stored` in the dataset file `dataset_file`."
  @spec from_stored(String.t(), Path.t()) :: Path.t()
  def from_stored(stored, dataset_file),
    do: if(address?(stored), do: stored, else: resolve_absolute(stored, dataset_file))

  defp resolve_absolute(stored, dataset_file) do
    style = path_style(dataset_file)
    {root, segments} = split_parts(stored, style)
    {base_root, base} = folder_parts(dataset_file, style)

    if root == "",
      do: join_parts(base_root, normalize_segments(base ++ segments), style),
      else: join_parts(resolve_root(root, base_root), normalize_segments(segments), style)
  end

  @doc """
  Converts a path from a file that was written on Windows: backslashes become slashes.

      iex> Situ.Dataset.StoredPath.to_portable(~S(Session1\\Robot.0000))
      "Session1/Robot.0000"
  """
  @spec to_portable(String.t()) :: String.t()
  def to_portable(path), do: String.replace(path, "\\", "/")

  @doc "Returns whether the text is an address (`situ://lab1/lobby`) rather than a path."
  @spec address?(String.t()) :: boolean()
  def address?(path), do: path =~ ~r/\A[a-z][a-z0-9+.-]+:\/\//

  @doc "Returns whether a path starts with a Windows drive or share."
  @spec windows_path?(String.t()) :: boolean()
  def windows_path?(path), do: path =~ ~r/\A([A-Za-z]:([\\\/]|\z)|\\\\)/

  defp path_style(path), do: if(windows_path?(path), do: :windows, else: :posix)

  defp folder_parts(file, style) do
    {root, segments} = split_parts(file, style)
    {root, segments |> normalize_segments() |> Enum.drop(-1)}
  end

  @spec split_parts(String.t(), :windows | :posix) :: parts()
  defp split_parts("/" <> rest, :posix), do: {"/", split_segments(rest, ["/"])}
  defp split_parts(path, :posix), do: {"", split_segments(path, ["/"])}

  defp split_parts(path, :windows) do
    cond do
      path =~ ~r/\A[\\\/]{2}/ ->
        {share, rest} = path |> split_segments(["\\", "/"]) |> Enum.split(2)
        {"\\\\" <> Enum.join(share, "\\") <> "\\", rest}

      path =~ ~r/\A[A-Za-z]:/ ->
        <<drive::binary-size(2), rest::binary>> = path
        {drive <> "\\", split_segments(rest, ["\\", "/"])}

      path =~ ~r/\A[\\\/]/ ->
        {"\\", split_segments(path, ["\\", "/"])}

      true ->
        {"", split_segments(path, ["\\", "/"])}
    end
  end

  defp split_segments(text, separators), do: String.split(text, separators, trim: true)

  # A path that starts at the root of the current drive is on the drive of the dataset file.
  defp resolve_root("\\", base_root), do: base_root
  defp resolve_root(root, _base_root), do: root

  defp normalize_segments(segments) do
    segments
    |> Enum.reduce([], fn
      ".", kept -> kept
      "..", [] -> []
      "..", [_ | kept] -> kept
      segment, kept -> [segment | kept]
    end)
    |> Enum.reverse()
  end

  defp relative_path(segments, base, style) do
    {up, down} = drop_common_prefix(base, segments, style)
    join_parts("", List.duplicate("..", length(up)) ++ down, style)
  end

  defp drop_common_prefix([a | base], [b | segments], style) do
    if same_segment?(a, b, style),
      do: drop_common_prefix(base, segments, style),
      else: {[a | base], [b | segments]}
  end

  defp drop_common_prefix(base, segments, _style), do: {base, segments}

  defp same_segment?(a, b, :windows), do: String.downcase(a) == String.downcase(b)
  defp same_segment?(a, b, :posix), do: a == b

  defp join_parts("", [], _style), do: "."
  defp join_parts(root, segments, :windows), do: root <> Enum.join(segments, "\\")
  defp join_parts(root, segments, :posix), do: root <> Enum.join(segments, "/")
end
