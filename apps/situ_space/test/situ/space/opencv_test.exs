defmodule Situ.Space.OpenCVTest do
  use ExUnit.Case, async: true
  alias Situ.{Error, Image}
  alias Situ.Space.{Chessboard, OpenCV}

  @tag :opencv
  test "a session serves many requests, even after an error, until it is closed" do
    {:ok, session} = OpenCV.open()
    empty = Image.new_filled(64, 48, :gray8)

    for _ <- 1..3 do
      assert {:error, %Error{code: :no_board}} =
               Chessboard.corners(empty, {5, 4}, session: session)

      assert {:error, %Error{code: :opencv_failed, why: why}} =
               OpenCV.call_program(session, <<9>>)

      assert why =~ "unknown request"

      assert {:error, %Error{code: :opencv_failed, why: why}} =
               OpenCV.call_program(session, <<1, 5, 4, 9::32>>)

      assert why =~ "too short"
    end

    assert OpenCV.close(session) == :ok

    assert {:error, %Error{code: :opencv_ended, fix: "open a new session"}} =
             OpenCV.call_program(session, <<9>>)
  end

  @tag :opencv
  test "a session whose program dies returns an error" do
    {:ok, session} = OpenCV.open()
    {:os_pid, pid} = Port.info(:sys.get_state(session.server), :os_pid)
    {_, 0} = System.cmd("kill", ["-9", "#{pid}"])
    assert {:error, %Error{code: :opencv_ended}} = OpenCV.call_program(session, <<9>>)
  end

  @tag :opencv
  test "a session ends with the process that opened it" do
    parent = self()
    owner = spawn(fn -> send(parent, OpenCV.open()) end)
    ref = Process.monitor(owner)
    assert_receive {:ok, %OpenCV{server: server}}
    assert_receive {:DOWN, ^ref, _, _, _}
    ref = Process.monitor(server)
    assert_receive {:DOWN, ^ref, _, _, _}
  end
end
