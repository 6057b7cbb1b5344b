defmodule Situ.Live.Static do
  @moduledoc false
  # Serves files below one folder. Only names of regular files inside the folder succeed. A `..`, a link out of the
  # folder, a device or a folder returns the same 404, so that a client cannot distinguish them.
  alias Situ.Live.{ContentType, Request, Response}

  @spec serve_file(Request.t(), Path.t() | {atom(), Path.t()}, [String.t()], keyword()) ::
          Response.t()
  def serve_file(request, dir, segments, opts) do
    root = root_folder(dir)

    with true <- segments != [] and Enum.all?(segments, &safe_segment?/1),
         path = Path.join([root | segments]),
         true <- inside_folder?(path, root) do
      file_response(request, path, opts)
    else
      _ -> Response.error(404, "not found")
    end
  end

  defp root_folder({app, dir}), do: Application.app_dir(app, dir)
  defp root_folder(dir), do: Path.expand(dir)

  # Names that start with a dot (.git, .env) are not public.
  defp safe_segment?(segment) do
    segment not in ["", ".", ".."] and not String.starts_with?(segment, ".") and
      :binary.match(segment, ["/", "\\", <<0>>]) == :nomatch
  end

  # Resolves links, so that a link inside the folder cannot lead out of it.
  defp inside_folder?(path, root) do
    with {:ok, path} <- real_path(path), {:ok, root} <- real_path(root) do
      String.starts_with?(path, root <> "/")
    else
      _ -> false
    end
  end

  defp real_path(path), do: resolve_links(Path.split(Path.expand(path)), "/", 0)
  defp resolve_links(_, _, links) when links > 16, do: :error
  defp resolve_links([], resolved, _), do: {:ok, resolved}

  defp resolve_links([part | rest], resolved, links) do
    path = Path.join(resolved, part)

    case File.read_link(path) do
      {:ok, target} ->
        resolve_links(Path.split(Path.expand(target, resolved)) ++ rest, "/", links + 1)

      {:error, :einval} ->
        resolve_links(rest, path, links)

      {:error, _} ->
        :error
    end
  end

  # If the folder also contains a compressed copy (app.js.gz), clients that accept gzip receive it.
  defp file_response(request, path, opts) do
    encodings = to_string(Request.get_header(request, "accept-encoding"))
    range? = Request.get_header(request, "range") != nil

    if not range? and String.contains?(encodings, "gzip") and File.regular?(path <> ".gz") do
      request
      |> Response.file(path <> ".gz", [type: ContentType.content_type(path)] ++ opts)
      |> Response.put_header("content-encoding", "gzip")
      |> Response.put_header("vary", "accept-encoding")
    else
      Response.file(request, path, opts)
    end
  end
end
