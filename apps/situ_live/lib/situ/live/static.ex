defmodule Situ.Live.Static do
  @moduledoc false
  # Serves files below one folder. Only names of regular files inside the folder succeed. A `..`, a link out of the
  # folder, a device or a folder returns the same 404, so that a client cannot distinguish them.
  alias Situ.Live.{Mime, Request, Response}

  @spec serve(Request.t(), Path.t() | {atom(), Path.t()}, [String.t()], keyword()) :: Response.t()
  def serve(request, dir, segments, opts) do
    root = root(dir)

    with true <- segments != [] and Enum.all?(segments, &safe?/1),
         path = Path.join([root | segments]),
         true <- inside?(path, root) do
      respond(request, path, opts)
    else
      _ -> Response.error(404, "not found")
    end
  end

  defp root({app, dir}), do: Application.app_dir(app, dir)
  defp root(dir), do: Path.expand(dir)

  # Names that start with a dot (.git, .env) are not public.
  defp safe?(segment) do
    segment not in ["", ".", ".."] and not String.starts_with?(segment, ".") and
      :binary.match(segment, ["/", "\\", <<0>>]) == :nomatch
  end

  # Resolves links, so that a link inside the folder cannot lead out of it.
  defp inside?(path, root) do
    with {:ok, path} <- real(path), {:ok, root} <- real(root) do
      String.starts_with?(path, root <> "/")
    else
      _ -> false
    end
  end

  defp real(path), do: real(Path.split(Path.expand(path)), "/", 0)
  defp real(_, _, links) when links > 16, do: :error
  defp real([], done, _), do: {:ok, done}

  defp real([part | rest], done, links) do
    path = Path.join(done, part)

    case File.read_link(path) do
      {:ok, target} ->
        real(Path.split(Path.expand(target, done)) ++ rest, "/", links + 1)

      {:error, :einval} ->
        real(rest, path, links)

      {:error, _} ->
        :error
    end
  end

  # If the folder also contains a compressed copy (app.js.gz), clients that accept gzip receive it.
  defp respond(request, path, opts) do
    accepts = to_string(Request.header(request, "accept-encoding"))
    range? = Request.header(request, "range") != nil

    if not range? and String.contains?(accepts, "gzip") and File.regular?(path <> ".gz") do
      request
      |> Response.file(path <> ".gz", [type: Mime.type(path)] ++ opts)
      |> Response.put_header("content-encoding", "gzip")
      |> Response.put_header("vary", "accept-encoding")
    else
      Response.file(request, path, opts)
    end
  end
end
