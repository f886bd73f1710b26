//! The control script's text, as far as it is the same for every arm; what it does is told in `script`.

/// What the script defines: motions in threads of their own, the way to a target, braking, forces.
pub(crate) const BODY: &str = "  global g_kind = 0
  global g_moving = 0
  global g_thread = 0
  global g_target = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
  global g_near = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
  global g_servo = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
  global g_at = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
  global g_rate = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
  global g_gone = [0.0, 0.0, 0.0]
  global g_probe = 0.01
  global g_braking = 0.8
  global g_rest = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
  global g_speed = 0.0
  global g_acceleration = 0.0
  global g_time = 0.0
  global g_force = 0.0
  global g_lookahead = 0.1
  global g_gain = 300.0
  global g_least = 0.0
  global g_begins_pressed = False
  global g_step = get_steptime()
  global g_met = p[0.0, 0.0, 0.0, 0.0, 0.0, 0.0]

  def g_pose():
    return p[g_target[0], g_target[1], g_target[2], g_target[3], g_target[4], g_target[5]]
  end

  def g_read(first):
    six = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    i = 0
    while i < 6:
      six[i] = read_input_float_register(first + i)
      i = i + 1
    end
    return six
  end

  thread g_move():
    if g_kind == 1:
      movej(g_target, a=g_acceleration, v=g_speed)
    elif g_kind == 2:
      movej(get_inverse_kin(g_pose(), g_near), a=g_acceleration, v=g_speed)
    else:
      movel(g_pose(), a=g_acceleration, v=g_speed, t=g_time)
    end
    g_moving = 0
  end

  thread g_relieve():
    movel(g_met, a=g_acceleration, v=0.05)
    g_moving = 0
  end

  def g_ahead(rate, time):
    six = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    i = 0
    while i < 6:
      six[i] = g_at[i] + rate[i] * time
      i = i + 1
    end
    return six
  end

  def g_toward(goal):
    way = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    wanted = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    far = 0.0
    most = 0.0
    i = 0
    while i < 6:
      way[i] = goal[i] - g_at[i]
      far = far + way[i] * way[i]
      if norm(way[i]) > most:
        most = norm(way[i])
      end
      i = i + 1
    end
    far = sqrt(far)
    here = get_forward_kin(g_at)
    if far > 0.0000001:
      i = 0
      while i < 6:
        way[i] = way[i] / far
        i = i + 1
      end
      most = most / far
      nearer = get_forward_kin(g_ahead(way, g_probe))
      farther = get_forward_kin(g_ahead(way, 2.0 * g_probe))
      lever = norm([nearer[0] - here[0], nearer[1] - here[1], nearer[2] - here[2]]) / g_probe
      bend = norm([farther[0] - 2.0 * nearer[0] + here[0], farther[1] - 2.0 * nearer[1] + here[1], farther[2] - 2.0 * nearer[2] + here[2]]) / (g_probe * g_probe)
      brake = g_braking * g_joint_acceleration / most
      if brake * lever > g_braking * g_acceleration:
        brake = g_braking * g_acceleration / lever
      end
      change = brake * g_step
      fast = 0.5 * (sqrt(change * change + 8.0 * brake * far) - change)
      if fast > far / g_step:
        fast = far / g_step
      end
      if fast * most > g_joint_speed:
        fast = g_joint_speed / most
      end
      if fast * lever > g_speed:
        fast = g_speed / lever
      end
      if fast * fast * bend > 0.5 * g_acceleration:
        fast = sqrt(0.5 * g_acceleration / bend)
      end
      i = 0
      while i < 6:
        wanted[i] = fast * way[i]
        i = i + 1
      end
    end
    share = 1.0
    change = g_joint_acceleration * g_step
    i = 0
    while i < 6:
      more = norm(wanted[i] - g_rate[i])
      if more * share > change:
        share = change / more
      end
      i = i + 1
    end
    keeps = get_forward_kin(g_ahead(g_rate, g_step))
    goes = get_forward_kin(g_ahead(wanted, g_step))
    bound = g_acceleration * g_step * g_step
    aa = 0.0
    ab = 0.0
    bb = 0.0 - bound * bound
    i = 0
    while i < 3:
      turn = keeps[i] - here[i] - g_gone[i]
      more = goes[i] - keeps[i]
      aa = aa + more * more
      ab = ab + turn * more
      bb = bb + turn * turn
      i = i + 1
    end
    if aa + 2.0 * ab + bb > 0.0 and aa > 0.0:
      part = 0.0 - ab / aa
      if ab * ab > aa * bb:
        part = (sqrt(ab * ab - aa * bb) - ab) / aa
      end
      if part < 0.0:
        part = 0.0
      end
      if part < share:
        share = part
      end
    end
    i = 0
    while i < 6:
      wanted[i] = g_rate[i] + share * (wanted[i] - g_rate[i])
      i = i + 1
    end
    ahead = g_ahead(wanted, g_step)
    there = get_forward_kin(ahead)
    g_gone = [there[0] - here[0], there[1] - here[1], there[2] - here[2]]
    g_rate = wanted
    g_at = ahead
  end

  thread g_follow():
    while True:
      g_toward(g_servo)
      servoj(g_at, t=g_step, lookahead_time=g_lookahead, gain=g_gain)
    end
  end

  def g_brake():
    if g_moving != 0:
      kill g_thread
      g_moving = 0
      if g_kind == 3 or g_kind == 4:
        stopl(g_stop_line)
      else:
        stopj(g_stop_joint)
      end
    end
  end

  def g_finish(number, result):
    write_output_integer_register(26, result)
    write_output_integer_register(27, number)
    write_output_integer_register(24, 1)
  end

  def g_feel_rest():
    f = get_tcp_force()
    n = norm([f[0], f[1], f[2]])
    g_least = n
    g_begins_pressed = False
    if n > g_rest_most:
      g_begins_pressed = True
      s = g_rest_most / n
      return [s * f[0], s * f[1], s * f[2], 0.0, 0.0, 0.0]
    end
    return f
  end

  def g_pressed():
    f = get_tcp_force()
    n = norm([f[0], f[1], f[2]])
    if n < g_least:
      g_least = n
    end
    if g_begins_pressed and n < g_least + 5.0:
      return 0.0
    end
    return norm([f[0] - g_rest[0], f[1] - g_rest[1], f[2] - g_rest[2]])
  end

  tcp_before = get_tcp_offset()
  set_tcp(p[0, 0, 0, 0, 0, 0])
";

/// The loop that obeys the mailbox, once in each step of the controller.
pub(crate) const LOOP: &str = "  number = read_input_integer_register(24)
  beat = read_input_integer_register(26)
  missed = 0
  count = 0
  stale = 0
  busy = False
  relieves = False
  going = True
  write_output_integer_register(25, number)
  write_output_integer_register(26, 0)
  write_output_integer_register(27, number)
  write_output_integer_register(29, 0)
  write_output_integer_register(24, 1)
  while going:
    now = read_input_integer_register(26)
    if now == beat:
      missed = missed + 1
    else:
      missed = 0
      beat = now
    end
    asked = read_input_integer_register(24)
    if missed > g_missed_most:
      g_brake()
      write_output_integer_register(29, 1)
      going = False
    elif asked != number:
      g_brake()
      number = asked
      g_kind = read_input_integer_register(25)
      g_target = g_read(24)
      g_near = g_read(30)
      g_speed = read_input_float_register(36)
      g_acceleration = read_input_float_register(37)
      g_time = read_input_float_register(38)
      g_force = read_input_float_register(39)
      g_lookahead = read_input_float_register(40)
      g_gain = read_input_float_register(41)
      g_rest = g_feel_rest()
      busy = True
      relieves = False
      write_output_integer_register(24, 2)
      write_output_integer_register(25, number)
      if g_kind == 99:
        write_output_integer_register(29, 2)
        going = False
      elif g_kind == 9:
        busy = False
        g_finish(number, 3)
      elif g_kind == 5 or g_kind == 6:
        g_servo = get_target_joint_positions()
        g_at = g_servo
        g_rate = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
        g_gone = [0.0, 0.0, 0.0]
        count = read_input_integer_register(27)
        stale = 0
        g_moving = 1
        g_thread = run g_follow()
      else:
        g_moving = 1
        g_thread = run g_move()
      end
    elif busy:
      if relieves:
        if g_moving == 0:
          busy = False
          g_finish(number, 2)
        end
      elif g_pressed() > g_force:
        g_met = get_actual_tcp_pose()
        g_brake()
        if g_kind == 4:
          relieves = True
          g_moving = 1
          g_thread = run g_relieve()
        else:
          busy = False
          g_finish(number, 6)
        end
      elif g_kind == 5 or g_kind == 6:
        counted = read_input_integer_register(27)
        if counted == count:
          stale = stale + 1
        else:
          stale = 0
          count = counted
          g_target = g_read(24)
          if g_kind == 5:
            g_servo = g_target
          else:
            g_servo = get_inverse_kin(g_pose(), g_servo)
          end
        end
        if stale > g_stale_most:
          g_brake()
          busy = False
          g_finish(number, 4)
        end
      elif g_moving == 0:
        busy = False
        g_finish(number, 1)
      end
    end
    sync()
  end
  set_tcp(tcp_before)
  write_output_integer_register(24, 0)
end
";
