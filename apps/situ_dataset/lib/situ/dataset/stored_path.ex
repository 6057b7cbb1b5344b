defmodule Situ.Dataset.StoredPath do
  @moduledoc """
  Converts paths of recordings to the form stored in a dataset file, which is relative to the file, so that the file
  and its recordings can be moved together.

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

  @typedoc "Root (\"\" if the path is relative) and segments."
  @type parts :: {root :: String.t(), [String.t()]}

  @doc """
  Returns the form of `path` that the dataset file `dataset_file` stores; a relative path keeps its spelling.
  """
  @spec to_stored(Path.t(), Path.t()) :: String.t()
  def to_stored(path, dataset_file),
    do: if(address?(path), do: path, else: relative_to(path, dataset_file))

  defp relative_to(path, dataset_file) do
    style = style(dataset_file)
    {root, segments} = parts(path, style)
    {base_root, base} = folder(dataset_file, style)

    cond do
      root == "" ->
        join("", segments, style)

      same?(rooted(root, base_root), base_root, style) ->
        relative(normal(segments), base, style)

      true ->
        join(root, normal(segments), style)
    end
  end

  @doc "Returns the absolute path of the path `stored` in the dataset file `dataset_file`."
  @spec from_stored(String.t(), Path.t()) :: Path.t()
  def from_stored(stored, dataset_file),
    do: if(address?(stored), do: stored, else: absolute(stored, dataset_file))

  defp absolute(stored, dataset_file) do
    style = style(dataset_file)
    {root, segments} = parts(stored, style)
    {base_root, base} = folder(dataset_file, style)

    if root == "",
      do: join(base_root, normal(base ++ segments), style),
      else: join(rooted(root, base_root), normal(segments), style)
  end

  @doc """
  Converts a path from a file that was written on Windows: backslashes become slashes.

      iex> Situ.Dataset.StoredPath.portable(~S(Session1\\Robot.0000))
      "Session1/Robot.0000"
  """
  @spec portable(String.t()) :: String.t()
  def portable(path), do: String.replace(path, "\\", "/")

  @doc "Returns whether the text is an address (`situ://lab1/lobby`) rather than a path."
  @spec address?(String.t()) :: boolean()
  def address?(path), do: path =~ ~r/\A[a-z][a-z0-9+.-]+:\/\//

  @doc "Returns whether a path starts with a Windows drive or share."
  @spec windows?(String.t()) :: boolean()
  def windows?(path), do: path =~ ~r/\A([A-Za-z]:([\\\/]|\z)|\\\\)/

  defp style(path), do: if(windows?(path), do: :windows, else: :posix)

  defp folder(file, style) do
    {root, segments} = parts(file, style)
    {root, segments |> normal() |> Enum.drop(-1)}
  end

  @spec parts(String.t(), :windows | :posix) :: parts()
  defp parts("/" <> rest, :posix), do: {"/", split(rest, ["/"])}
  defp parts(path, :posix), do: {"", split(path, ["/"])}

  defp parts(path, :windows) do
    cond do
      path =~ ~r/\A[\\\/]{2}/ ->
        {share, rest} = path |> split(["\\", "/"]) |> Enum.split(2)
        {"\\\\" <> Enum.join(share, "\\") <> "\\", rest}

      path =~ ~r/\A[A-Za-z]:/ ->
        <<drive::binary-size(2), rest::binary>> = path
        {drive <> "\\", split(rest, ["\\", "/"])}

      path =~ ~r/\A[\\\/]/ ->
        {"\\", split(path, ["\\", "/"])}

      true ->
        {"", split(path, ["\\", "/"])}
    end
  end

  defp split(text, separators), do: String.split(text, separators, trim: true)

  # A path that starts at the root of the current drive is on the drive of the dataset file.
  defp rooted("\\", base_root), do: base_root
  defp rooted(root, _base_root), do: root

  defp normal(segments) do
    segments
    |> Enum.reduce([], fn
      ".", kept -> kept
      "..", [] -> []
      "..", [_ | kept] -> kept
      segment, kept -> [segment | kept]
    end)
    |> Enum.reverse()
  end

  defp relative(segments, base, style) do
    {up, down} = diverge(base, segments, style)
    join("", List.duplicate("..", length(up)) ++ down, style)
  end

  defp diverge([a | base], [b | segments], style) do
    if same?(a, b, style), do: diverge(base, segments, style), else: {[a | base], [b | segments]}
  end

  defp diverge(base, segments, _style), do: {base, segments}

  defp same?(a, b, :windows), do: String.downcase(a) == String.downcase(b)
  defp same?(a, b, :posix), do: a == b

  defp join("", [], _style), do: "."
  defp join(root, segments, :windows), do: root <> Enum.join(segments, "\\")
  defp join(root, segments, :posix), do: root <> Enum.join(segments, "/")
end
