defmodule Situ.Dataset.StoredPathTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Dataset.StoredPath

  doctest Situ.Dataset.StoredPath

  @windows ~S(C:\subdir1\dataset.pds)

  test "stores Windows paths" do
    for {path, stored} <- [
          {~S(C:\file.txt), ~S(..\file.txt)},
          {~S(c:\SUBDIR1\file.txt), "file.txt"},
          {~S(C:/subdir1/subdir2/file.txt), ~S(subdir2\file.txt)},
          {~S(C:\subdir2\file.txt), ~S(..\subdir2\file.txt)},
          {~S(D:\subdir1\file.txt), ~S(D:\subdir1\file.txt)},
          {~S(\\host\share\file.txt), ~S(\\host\share\file.txt)},
          {"file.txt", "file.txt"},
          {"./file.txt", ~S(.\file.txt)},
          {"../file.txt", ~S(..\file.txt)}
        ],
        do: assert(StoredPath.to_stored(path, @windows) == stored)
  end

  test "resolves stored Windows paths" do
    for {stored, path} <- [
          {~S(.\file.txt), ~S(C:\subdir1\file.txt)},
          {"./file.txt", ~S(C:\subdir1\file.txt)},
          {~S(..\..\..\file.txt), ~S(C:\file.txt)},
          {~S(\file.txt), ~S(C:\file.txt)},
          {~S(\\host\share\a\..\file.txt), ~S(\\host\share\file.txt)}
        ],
        do: assert(StoredPath.from_stored(stored, @windows) == path)
  end

  property "restores an absolute path from any location" do
    forall {path, file} <- {path(), path()} do
      StoredPath.from_stored(StoredPath.to_stored(path, file), file) == path
    end
  end

  property "a moved folder keeps its recordings" do
    forall {below, file} <- {[segment(), segment(), segment()], path()} do
      folder = Path.dirname(file)
      stored = StoredPath.to_stored(Path.join([folder | below]), file)
      StoredPath.from_stored(stored, "/elsewhere/d.json") == Path.join(["/elsewhere" | below])
    end
  end

  defp path,
    do: map({segment(), list(segment())}, fn {a, more} -> "/" <> Enum.join([a | more], "/") end)

  defp segment, do: one_of(["a", "b", "c", "d.0000", "x y"])
end
